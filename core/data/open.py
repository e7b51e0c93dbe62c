"""Open a recording of any known layout."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from streamlod.core.data import caliscope, transforms
from streamlod.core.data.caliscope import read_caliscope
from streamlod.core.data.colmap.reader import is_colmap, read_colmap
from streamlod.core.data.dataset import Dataset, RawRecording, dataset
from streamlod.core.data.names import counted, folders_in, listed
from streamlod.core.data.transforms import read_transforms
from streamlod.core.data.video_folder import read_video_folder, video_files
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)

_READERS: dict[str, Callable[[Path], RawRecording]] = {
    "n3dv": lambda path: read_video_folder(path, "n3dv"),
    "meetroom": lambda path: read_video_folder(path, "meetroom"),
    "colmap": read_colmap,
    "transforms": read_transforms,
    "caliscope": read_caliscope,
}
LAYOUTS = tuple(_READERS)


def open_dataset(
    path: Path | str, *, layout: str | None = None, downscale: float = 1, cameras: Sequence[str] | None = None
) -> Dataset:
    """Open the recording in a folder; pictures are read only when `Dataset.frames` is iterated.

    Args:
        path: the folder (or the transforms.json in it).
        layout: one of `LAYOUTS`; None finds it out from the files.
        downscale: how many times smaller than the stored pictures, 1 or more; fractions are allowed.
        cameras: names of the cameras to use, in the order wanted; None for all, in numeric order.

    Raises:
        InputError: no such folder, or one that cannot be used; names the file and its fault. Also an unknown layout,
            or `downscale` below 1.
    """
    folder = Path(path)
    if folder == transforms.file_in(folder.parent):
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(folder, "is not a folder" if folder.exists() else "does not exist")
    if not any(folder.iterdir()):
        raise InputError(folder, "is an empty folder")
    chosen = _detect(folder) if layout is None else layout
    if chosen not in _READERS:
        raise InputError("layout", f"must be one of {', '.join(LAYOUTS)}, not {chosen!r}")
    opened = dataset(_READERS[chosen](folder), downscale, cameras)
    first = opened.cameras[0]
    _log.info(
        "%s: %s, %s, %s, %dx%d",
        *(folder, chosen, counted(len(opened.cameras), "camera"), counted(opened.frame_count, "frame")),
        *(first.width, first.height),
    )
    return opened


def _detect(folder: Path) -> str:
    layout = _layout_of(folder)
    if layout is not None:
        return layout
    inside = [inner.name for inner in folders_in(folder) if _layout_of(inner) is not None]
    if inside:
        raise InputError(folder, f"is no recording, but holds {listed(inside, 3)}; name that folder")
    raise InputError(
        folder,
        "is not a recording in a known layout; it needs camNN.mp4 or cam_N.mp4 with poses_bounds.npy, a COLMAP model "
        "in sparse/0 with images, a transforms.json, or a camera_array.toml, as streamlod calibrate makes of a walk",
    )


def _layout_of(folder: Path) -> str | None:
    if (folder / caliscope.FILE).is_file():
        return "caliscope"
    if (folder / transforms.FILE).is_file():
        return "transforms"
    for layout in ("n3dv", "meetroom"):
        if video_files(folder, layout):
            return layout
    if is_colmap(folder):
        return "colmap"
    if (folder / "poses_bounds.npy").is_file():
        return "n3dv"  # whose reader then says which videos are missing
    return None if transforms.file_in(folder) is None else "transforms"  # videos of N3DV have them beside, converted
