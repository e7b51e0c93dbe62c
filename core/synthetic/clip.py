"""A synthetic clip as a data set in memory, and as files in the N3DV layout."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.data.dataset import Dataset, RawRecording, dataset
from streamlod.core.data.files import read_json
from streamlod.core.errors import InputError
from streamlod.core.synthetic.render import depth_bounds, ground_truth, render_image
from streamlod.core.synthetic.spec import SyntheticSpec, cameras, exposures

_SPEC = Path("ground_truth") / "spec.json"
_LATER = {"kind", "speed"}  # absent from clips of earlier versions
_TRUTH_FRAMES = 4  # instants whose ground truth is written: the first, the last and two between


@dataclass(frozen=True, slots=True)
class SyntheticSource:
    """Pictures of a synthetic clip, rendered as they are asked for; a `Source`."""

    spec: SyntheticSpec

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self.spec.fps

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self.spec.frames

    def time_ns(self, index: int) -> int:
        """Time of a frame from the clip's start."""
        return round(index * 1e9 / self.spec.fps)

    def pictures(self, camera: int, start: int, stop: int) -> Generator[UInt8 | None, None, None]:
        """Yield pictures; see `Source.pictures`."""
        for index in range(start, stop):
            yield render_image(self.spec, index, camera)

    def film(self, camera: int) -> None:
        """There is none; see `Source.film`."""


def open_synthetic(spec: SyntheticSpec) -> Dataset:
    """The clip as a data set that renders each picture when it is read; nothing is written."""
    bounds = depth_bounds(spec)
    source = SyntheticSource(spec)
    return dataset(RawRecording(Path("synthetic"), "synthetic", cameras(spec), source, depth_bounds=bounds))


def write_clip(spec: SyntheticSpec, folder: Path, progress: Callable[[float], None] | None = None) -> None:
    """Write the clip in the N3DV layout: ``camNN.mp4`` and ``poses_bounds.npy``.

    Beside them, ``ground_truth/`` holds ``spec.json`` (the spec, exact cameras and exposures) and ``frameNNNNN.npz`` of
    a few frames (depth [C,H,W] float16 metres, moving and mirror [C,H,W] bool, motion [C,H,W,3] float16 metres). The
    folder appears under its name when it is complete.

    Args:
        folder: must not exist yet, or be empty.
        progress: called with the fraction done.

    Raises:
        InputError: the folder holds something already, or cannot be written; or the size is odd, which H.264 refuses.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(folder, "exists already and is not an empty folder; name another or remove it")
    if spec.width % 2 or spec.height % 2:
        raise InputError("synthetic clip", f"video needs an even picture size, not {spec.width}x{spec.height}")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}") from error
    try:
        _write_files(spec, partial, progress or (lambda _: None))
        partial.chmod(0o755)
        partial.replace(folder)
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def read_spec(data: Path) -> SyntheticSpec | None:
    """The description of a synthetic clip in folder `data`, None for any other recording.

    Raises:
        InputError: a description that is none.
    """
    path = data / _SPEC
    if not path.is_file():
        return None
    value = read_json(path).get("spec")
    known: dict[str, type[Any]] = {field.name: type(field.default) for field in fields(SyntheticSpec)}
    if not isinstance(value, dict) or not set(known) - _LATER <= set(value) <= set(known):
        raise InputError(path, "does not describe a synthetic clip")
    for name, kind in known.items():
        if not isinstance(value.get(name, kind()), str if kind is str else int | float):
            raise InputError(path, f"holds a value of {name} that is of another type")
    return SyntheticSpec(**{name: known[name](held) for name, held in value.items()})


def poses_bounds(rig: tuple[Camera, ...], bounds: tuple[float, float]) -> Float64:
    """[C,17] as LLFF writes it: 3x5 [rotation down-right-back | centre | height, width, focal], near, far."""
    rows = []
    for camera in rig:
        right, down, forward = camera.world_to_camera[:3, :3]
        size = np.array([camera.height, camera.width, camera.intrinsics[0, 0]])
        matrix = np.stack([down, right, -forward, camera.centre, size], axis=1)
        rows.append(np.concatenate([matrix.ravel(), bounds]))
    return np.stack(rows)


def _write_files(spec: SyntheticSpec, folder: Path, progress: Callable[[float], None]) -> None:
    rig, bounds = cameras(spec), depth_bounds(spec)
    np.save(folder / "poses_bounds.npy", poses_bounds(rig, bounds))
    truth = folder / "ground_truth"
    truth.mkdir()
    chosen = sorted({round(index) for index in np.linspace(0, spec.frames - 1, _TRUTH_FRAMES)})
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(_write_video, spec, index, folder / f"{rig[index].name}.mp4") for index in range(len(rig))]
        jobs += [pool.submit(_write_truth, spec, index, truth / f"frame{index:05d}.npz") for index in chosen]
        try:
            for done, job in enumerate(jobs, 1):
                job.result()
                progress(done / len(jobs))
        finally:
            for job in jobs:
                job.cancel()
    (truth / "spec.json").write_text(json.dumps(_description(spec, rig, bounds), indent=1))


def _write_video(spec: SyntheticSpec, camera: int, path: Path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(spec.fps).limit_denominator(1001))
        # Videos are to be the truth: 34 to 43 dB. With colours of half the width and height (4:2:0) they had 28 to 39
        stream.width, stream.height, stream.pix_fmt = spec.width, spec.height, "yuv444p"
        stream.options = {"crf": "16", "x264-params": "chroma-qp-offset=-6", "preset": "veryfast", "threads": "1"}
        for index in range(spec.frames):
            picture = av.VideoFrame.from_ndarray(render_image(spec, index, camera), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def _write_truth(spec: SyntheticSpec, index: int, path: Path) -> None:
    views = [ground_truth(spec, index, camera) for camera in range(spec.cameras)]
    np.savez_compressed(
        path,
        depth=np.stack([view.depth for view in views]).astype(np.float16),
        motion=np.stack([view.motion for view in views]).astype(np.float16),
        moving=np.stack([view.moving for view in views]),
        mirror=np.stack([view.mirror for view in views]),
    )


def _description(spec: SyntheticSpec, rig: tuple[Camera, ...], bounds: tuple[float, float]) -> dict[str, object]:
    described = [
        {
            "name": camera.name,
            "intrinsics": camera.intrinsics.tolist(),
            "world_to_camera": camera.world_to_camera.tolist(),
            "exposure": factors.tolist(),
        }
        for camera, factors in zip(rig, exposures(spec), strict=True)
    ]
    return {"spec": asdict(spec), "depth_bounds": bounds, "cameras": described}
