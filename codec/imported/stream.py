"""Files of plain Gaussians, one or a sequence, as a `.slod` file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.export.upright import turned
from streamlod.codec.imported.field import Order, later, order_of, scene_of
from streamlod.codec.mp4.file import write_slod
from streamlod.codec.mp4.reader import is_mp4
from streamlod.codec.packet.limits import DEFAULT_LIMITS
from streamlod.codec.snapshots import CLIP_SUFFIXES, FORMATS, format_of
from streamlod.core.data.names import counted
from streamlod.core.errors import InputError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.scene.metadata import Metadata
from streamlod.core.scene.residual import difference

MAX_GAUSSIANS = DEFAULT_LIMITS.anchors  # of a stream: what players take
MAX_FILES = 100_000
STILL_SECONDS = 60  # that a file of one frame lasts, in packets of no change, one a second: viewers see that it lives
_MAX_TITLE = 200  # characters


def is_importable(path: Path) -> bool:
    """Whether the path is a file of plain Gaussians, one of a clip of them, or a folder that holds some; or packets
    in an MP4 file."""
    return (
        _is_clip(path)
        or is_mp4(path)
        or format_of(path) is not None
        or (path.is_dir() and any(format_of(child) for child in path.iterdir()))
    )


def import_files(
    source: Path,
    out: Path,
    fps: float = 30.0,
    most: int = MAX_GAUSSIANS,
    up: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> str:
    """Write the Gaussians of `source`, a file, a clip or a folder with a file for each frame, as a stream.

    Returns one line that says what was kept.

    Frames of as many Gaussians as the first, in one order, become changes; where the number differs, or a Gaussian
    grows by more than 1.9 since the keyframe, a new keyframe comes. View-dependent colour is dropped. Of an MP4 file
    with packets it takes these, byte for byte.

    Args:
        most: Gaussians of a frame that are kept, those that show most.
        up: the axis of the files that points up (`snapshots.AXES`); that of their format by default.
        tell: called with the name of each file that is read.

    Raises:
        InputError: no file of Gaussians, one that is damaged or holds none, or a place that cannot be written.
    """
    if is_mp4(source):
        if up is not None:
            raise InputError(source, "holds packets, which are taken as they are; --up is for Gaussians")
        packets, has_sound = write_slod(source, out)
        return f"{out}: {packets} packets as they were{', with sound' if has_sound else ''}"
    clouds = _clip(source, fps, up) if _is_clip(source) else _read_all(_files(source), up, tell)
    title = "".join(c for c in source.stem if c.isprintable())[:_MAX_TITLE] or None
    writer = _Frames(fps, min(most, MAX_GAUSSIANS), title)
    count = 0
    with SlodWriter(out) as slod:
        for path, cloud in clouds:
            try:
                slod.append(writer.packet(count, cloud))
            except ValueError as error:  # numbers beyond the bounds of a scene header
                raise InputError(path, f"cannot be made a stream: {error}") from error
            count += 1
        for second in range(1, STILL_SECONDS + 1) if count == 1 else ():
            slod.append(writer.still(second))
    lost = f", of {writer.seen} the {writer.kept} that show most" if writer.kept < writer.seen else ""
    frames = f"{counted(count, 'frame')} of {counted(writer.kept, 'Gaussian')}{lost}"
    return f"{out}: {frames}, {counted(writer.keyframes, 'keyframe')}"


class _Frames:
    """Packets of one frame after the other."""

    def __init__(self, fps: float, most: int, title: str | None) -> None:
        self._fps, self._most, self._facts = fps, most, Metadata(title=title)
        self._shown: tuple[Scene, Order] | None = None
        self.kept = self.seen = self.keyframes = 0

    def still(self, second: int) -> bytes:
        """A packet of no change, so many seconds after the keyframe."""
        assert self._shown is not None
        before, order = self._shown
        after = replace(before, version=second)
        self._shown = after, order
        return encode_residual(before, difference(before, after), time_ns=second * 10**9)

    def packet(self, number: int, cloud: GaussianCloud) -> bytes:
        """The packet of frame `number`."""
        time_ns = round(number * 1e9 / self._fps)
        if self._shown is not None and len(cloud) == self.seen:
            before, order = self._shown
            after = later(before, cloud, order, number)
            if after is not None:
                self._shown = after, order
                return encode_residual(before, difference(before, after), time_ns=time_ns)
        order = order_of(cloud, self._most)
        self.seen, self.kept = len(cloud), sum(map(len, order.levels))
        self.keyframes += 1
        keyframe = replace(scene_of(cloud, order, self._fps, number), metadata=self._facts)
        self._shown = keyframe, order
        return encode_keyframe(keyframe, time_ns=time_ns)


def _files(source: Path) -> list[Path]:
    """The file, or those of the folder in natural order."""
    if source.is_file() and format_of(source) is not None:
        return [source]
    known = ", ".join(dict.fromkeys((*(each.suffix for each in FORMATS.values()), *CLIP_SUFFIXES["4dgs"])))
    if not source.is_dir():
        other = "of other programs' files, splat-transform (npm) makes a .ply"
        raise InputError(source, f"is no file of Gaussians ({known}) and no folder of them; {other}")
    visible = (path for path in source.iterdir() if path.is_file() and not path.name.startswith("."))
    files = sorted((path for path in visible if format_of(path) is not None), key=_natural)
    if not files:
        raise InputError(source, f"holds no file of Gaussians ({known})")
    if len(files) > MAX_FILES:
        raise InputError(source, f"holds {len(files)} files, more than {MAX_FILES}")
    return files


def _natural(path: Path) -> list[tuple[int, str]]:
    """A key by which frame_2 comes before frame_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _is_clip(path: Path) -> bool:
    return path.name.lower().endswith(CLIP_SUFFIXES["4dgs"]) and path.is_file()


def _clip(path: Path, fps: float, up: str | None) -> Iterator[tuple[Path, GaussianCloud]]:
    """The frames of a `.4dgs` file."""
    from streamlod.codec.export.fourdgs_file import read_clip

    for cloud in read_clip(path, fps, up):
        yield path, _some(path, cloud)


def _read_all(files: list[Path], up: str | None, tell: Callable[[str], None]) -> Iterator[tuple[Path, GaussianCloud]]:
    for path in files:
        tell(path.name)
        known = format_of(path)
        assert known is not None
        yield path, _some(path, turned(known.decode(path), known.up, up or known.up))


def _some(path: Path, cloud: GaussianCloud) -> GaussianCloud:
    if len(cloud) == 0:
        raise InputError(path, "holds no Gaussians")
    return cloud
