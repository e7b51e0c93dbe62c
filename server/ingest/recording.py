"""A rig that is watched and recorded before it is calibrated: one video for each camera, on one clock."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path

import av

from streamlod.core.camera.grid import period_of
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.relay import listening
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import CameraState, Instant

_TELL_SECONDS = 5.0
_TICKS = 90_000  # a second, of the files' times
_ENCODER = {"preset": "ultrafast", "tune": "zerolatency", "crf": "17", "g": "30"}  # as fast as the cameras film


@contextmanager
def watching(definition: RigDefinition, push_socket: Path | None) -> Iterator[Rig]:
    """The rig of an uncalibrated definition in operation, with pictures that come at `push_socket`.

    Raises:
        InputError: the socket cannot be made.
    """
    rig = Rig(definition, [camera.name for camera in definition.cameras])
    with ExitStack() as stack:
        stack.callback(rig.stop)
        if push_socket is not None and rig.pushed:
            stack.enter_context(listening(push_socket, lambda: Intake(rig)))
        rig.start()
        yield rig


def first_whole(rig: Rig, seconds: float, waiting: Callable[[Mapping[str, str]], None]) -> Instant:
    """The first instant with a picture of every camera.

    Args:
        seconds: to wait at most.
        waiting: told every few seconds which cameras do not deliver, and why, where that is known.

    Raises:
        InputError: a camera did not come in time.
    """
    over = threading.Event()

    def tell() -> None:
        while not over.wait(_TELL_SECONDS):
            waiting(_missing(rig))

    telling = threading.Thread(target=tell, daemon=True, name="waiting")
    timer = threading.Timer(seconds, rig.stop)
    timer.daemon = True
    telling.start()
    timer.start()
    try:
        for instant in rig.instants():
            if all(picture is not None for picture in instant.pictures):
                return instant
        missing = _missing(rig)
    finally:
        timer.cancel()
        over.set()
        telling.join()
    name = next(iter(missing), "rig")
    raise InputError(f"camera {name}", missing.get(name) or f"sent no picture within {seconds:.0f} s")


def record(rig: Rig, definition: RigDefinition, folder: Path, seconds: float) -> dict[str, int]:
    """Record for so long, or until the sources end or the user interrupts; the pictures of each camera are counted.

    The files `NAME.mp4` have one clock: a picture's time is when it was taken, from one beginning for all.

    Raises:
        InputError: a file cannot be written.
    """
    begin: int | None = None
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(len(definition.cameras), "record"))
        writers = [
            stack.enter_context(_writing(folder / f"{camera.name}.mp4", (camera.width, camera.height), definition.fps))
            for camera in definition.cameras
        ]
        try:
            for instant in rig.instants():
                if begin is None:
                    begin = instant.capture_ns - round(period_of(definition.fps))  # no picture of it is older
                if instant.capture_ns - begin > seconds * 1e9:
                    break
                begins = [begin] * len(writers)
                list(pool.map(_Writer.write, writers, instant.pictures, begins))
        except KeyboardInterrupt:
            pass
        return {camera.name: writer.count for camera, writer in zip(definition.cameras, writers, strict=True)}


def _missing(rig: Rig) -> dict[str, str]:
    cameras = rig.statistics().cameras
    return {
        name: camera.refused or camera.fault for name, camera in cameras.items() if camera.state is CameraState.LOST
    }


class _Writer:
    """One camera's video."""

    def __init__(self, container: av.container.OutputContainer, size: tuple[int, int], fps: float) -> None:
        even = size[0] % 2 == 0 and size[1] % 2 == 0
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001), options=_ENCODER)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p" if even else "yuv444p"
        stream.codec_context.time_base = Fraction(1, _TICKS)
        self._container, self._stream, self._last, self.count = container, stream, -1, 0

    def write(self, picture: Picture | None, begin_ns: int) -> None:
        """Add a picture; one that is missing, damaged, or not later than the last, is left out."""
        ticks = -1 if picture is None else round((picture.capture_ns - begin_ns) * _TICKS / 1e9)
        if picture is None or ticks <= self._last:
            return
        try:
            frame = av.VideoFrame.from_ndarray(picture.load(), format="rgb24")
        except InputError:
            return
        frame.pts, frame.time_base = ticks, Fraction(1, _TICKS)
        self._container.mux(self._stream.encode(frame))
        self._last, self.count = ticks, self.count + 1

    def end(self) -> None:
        """Write what the encoder still holds."""
        self._container.mux(self._stream.encode())


@contextmanager
def _writing(file: Path, size: tuple[int, int], fps: float) -> Iterator[_Writer]:
    try:
        with av.open(str(file), "w", format="mp4") as container:
            writer = _Writer(container, size, fps)
            yield writer
            if writer.count:
                writer.end()
    except (av.FFmpegError, OSError) as error:
        raise InputError(file, f"cannot be written ({error.strerror or error})") from error
