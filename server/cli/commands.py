"""The commands `synth`, `train`, `serve`, `push`, `bench`, `version` and `warm`; they return the text to print."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import logging
import os
import pkgutil
import platform
import re
import runpy
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from streamlod.core.data.names import counted
from streamlod.core.errors import BackendUnavailable, BitstreamError, InputError, TrainingCutShort
from streamlod.core.files import write_text
from streamlod.core.options import TOKEN_VARIABLE
from streamlod.core.progress_bar import Bar, progress_bar
from streamlod.core.runtime import cache_folder
from streamlod.core.version import streamlod_version
from streamlod.server.pipeline.stages.trace import chrome_trace

if TYPE_CHECKING:
    from collections.abc import Callable

    from streamlod.core.train import Progress
    from streamlod.server.pipeline.job import TrainJob
    from streamlod.server.pipeline.spec import StreamSpec
    from streamlod.server.pipeline.stages.encoding import EncodedFrame
    from streamlod.server.settings import Settings

_BENCHES = "tests.bench"
_SUFFIX = "_bench"
_LOG = logging.getLogger(__name__)


def picture_size(text: str) -> tuple[int, int]:
    """(width, height) of ``480x270``; InputError for anything else."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise InputError("--size", f"{text!r} is not WIDTHxHEIGHT, for example 480x270")
    return int(match[1]), int(match[2])


def synth(
    folder: Path, cameras: int, frames: int, size: str, seed: int, kind: str, speed: float, overwrite: bool
) -> str:
    """Write a synthetic clip."""
    width, height = picture_size(size)
    from streamlod.core.synthetic import SyntheticSpec, write_clip

    spec = SyntheticSpec(cameras=cameras, frames=frames, width=width, height=height, seed=seed, kind=kind, speed=speed)
    if overwrite and (folder / "ground_truth" / "spec.json").is_file():  # nothing but our own clips
        shutil.rmtree(folder)
    with progress_bar(total=100, unit="%", desc="synth") as bar:
        write_clip(spec, folder, lambda fraction: _set(bar, 100 * fraction))
    return f"{folder}: {kind}, {counted(cameras, 'camera')}, {counted(frames, 'frame')} of {size}"


def check_cameras(job: TrainJob) -> None:
    """Refuse an unusable recording, rig or choice of cameras within a second, before a training library is loaded."""
    from streamlod.core.data import open_dataset, training_cameras
    from streamlod.server.ingest.cameras.definition import read_definition

    if job.data is not None:
        names = open_dataset(job.data, layout=job.layout, downscale=job.downscale).names
    elif isinstance(job.live, Path):
        names = tuple(camera.name for camera in read_definition(job.live).cameras)
    else:
        return
    training_cameras(names, job.train, job.views, job.test)


def train(job: TrainJob, out: Path, figures: Path | None, trace: Path | None, sound: str) -> str:
    """Train a clip into a `.slod` file, with figures and sound beside it."""
    from streamlod.codec.sound.beside import sound_beside
    from streamlod.server.pipeline.clip import train_clip
    from streamlod.server.pipeline.stages.opened import open_job

    opened = open_job(job)
    encoded: list[EncodedFrame] = []
    with (
        progress_bar(total=100, unit="%", desc="first frame") as first,
        progress_bar(unit="frame", desc="frames") as later,
    ):

        def on_progress(progress: Progress) -> None:
            _set(first, 100 * progress.fraction)

        def on_frame(frame: EncodedFrame) -> None:
            encoded.append(frame)
            _set(first, 100)
            later.update()

        cut: TrainingCutShort | None = None
        try:
            train_clip(opened, out, on_frame, on_progress, sound)
        except TrainingCutShort as error:
            cut = error
    sidecar = json.loads(out.with_name(out.name + ".json").read_text(encoding="utf-8"))
    if figures is not None:
        write_text(figures, json.dumps(sidecar, indent=1) + "\n")
    if trace is not None:
        spans = chrome_trace((frame.version, frame.spans) for frame in encoded)
        write_text(trace, json.dumps(spans, indent=1) + "\n")
    if cut is not None:
        raise cut
    first_frame, later_frames = sidecar.get("first_frame_seconds"), sidecar.get("train_seconds")
    spent = f"first frame {first_frame:.1f} s" if first_frame is not None else "resumed"
    spent += f", later frames {later_frames:.2f} s each" if later_frames is not None else ""
    heard = sound_beside(out).exists()
    size = f"{counted(len(encoded), 'frame')}, {out.stat().st_size / 1000:.1f} KB"
    return f"{out}: {size}, {'with sound, ' if heard else ''}{spent}"


def playable(path: Path) -> Path:
    """The `.slod` file to play for `path`: itself, or one made of the Gaussians of a file or folder, kept in the cache.

    Raises:
        InputError: nothing that can be played is there, or the cache cannot be written.
    """
    from streamlod.codec.imported import import_files, is_importable
    from streamlod.codec.opening import open_packets

    if not path.exists():
        raise InputError(path, "does not exist")
    if not is_importable(path):
        try:
            open_packets(path).close()
        except BitstreamError as error:
            known = ".slod, .mp4, .ply, .spz, .glb and .4dgs"
            raise InputError(path, f"cannot be played: {error}; {known} can") from error
        return path
    newest = max(each.stat().st_mtime_ns for each in (path, *(path.iterdir() if path.is_dir() else ())))
    name = hashlib.blake2b(f"{path.resolve()} {newest}".encode(), digest_size=8).hexdigest()
    made = cache_folder() / "imported" / f"{name}.slod"
    if not made.exists():
        try:
            made.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(made.parent, f"cannot be made ({error.strerror}); use streamlod import") from error
        _LOG.info("%s", import_files(path, made))
    return made


def serve(settings: Settings, streams: tuple[StreamSpec, ...], read_settings: Callable[[], Settings]) -> NoReturn:
    """Serve until told to stop, which ends the process; SIGHUP calls `read_settings`."""
    from streamlod.core.render import select
    from streamlod.server.pipeline.checks import check_job
    from streamlod.server.pipeline.recorded import streamed_packets
    from streamlod.server.service.ending import end_process
    from streamlod.server.service.run import serve as run

    for stream in streams:
        job = stream.job
        for path in (stream.play, job and job.data, job and job.live):
            if isinstance(path, Path) and not path.exists():
                raise InputError(path, "does not exist")
        if stream.play is not None:
            streamed_packets(stream.play)
        if job is not None:
            check_job(job)
        if job is not None and job.device == "cuda":
            select(job.device)  # a GPU that was asked for is never replaced by the CPU in silence
    with suppress(KeyboardInterrupt):  # the signal that ended it, raised again after an orderly end
        run(settings, streams, read_settings)
    end_process()


def push(url: str, sources: list[str], fps: float, size: str | None, loop: bool, ca: Path | None = None) -> str:
    """Be a capture node until the sources end."""
    from streamlod.server.ingest.push.node import push as send
    from streamlod.server.ingest.push.sources import find_cameras

    cameras = find_cameras(sources, fps, None if size is None else picture_size(size), repeats=loop)
    pushed = send(url, cameras, os.environ.get(TOKEN_VARIABLE), ca)
    return "\n".join(
        f"{name}: {one.acknowledged} pictures taken, {one.refused} refused, {one.dropped} dropped"
        for name, one in pushed.items()
    )


def bench(name: str | None, arguments: list[str]) -> str:
    """Run a benchmark of the source checkout, or list them."""
    names = _benches()
    if name is None:
        return "benchmarks: " + ", ".join(names)
    if name not in names:
        raise InputError(f"bench {name}", f"is not a benchmark; there are: {', '.join(names)}")
    module = f"{_BENCHES}.{name.replace('-', '_')}{_SUFFIX}"
    before = sys.argv
    sys.argv = [module, *arguments]
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    finally:
        sys.argv = before
    return ""


def version() -> str:
    """Versions that have to fit those of other machines, a line each."""
    from streamlod.client.playback import PROTOCOL_VERSION
    from streamlod.codec.packet.bytes import FORMAT_VERSION

    return (
        f"streamlod {streamlod_version()}\nbitstream {FORMAT_VERSION}\nviewer protocol {PROTOCOL_VERSION}\n"
        f"Python {platform.python_version()}"
    )


def warm() -> str:
    """Compile all kernels now rather than at first use."""
    from streamlod.server.pipeline.warming import WARM_UPS, warm_all

    with progress_bar(total=len(WARM_UPS), unit="part", desc="compiling") as bar:
        for name in warm_all():
            bar.set_description(f"compiling; {name} ready")
            bar.update()
    return "ready"


def _benches() -> list[str]:
    with suppress(ModuleNotFoundError):
        spec = importlib.util.find_spec(_BENCHES)
        if spec is not None and spec.submodule_search_locations:
            modules = pkgutil.iter_modules(spec.submodule_search_locations)
            found = [module.name for module in modules if module.name.endswith(_SUFFIX)]
            return sorted(name.removesuffix(_SUFFIX).replace("_", "-") for name in found)
    raise BackendUnavailable("the benchmark suite", "it comes with a source checkout: run it there")


def _set(bar: Bar, value: float) -> None:
    bar.update(max(0, round(value) - bar.n))
