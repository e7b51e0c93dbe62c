"""A rig that is watched and recorded before it is calibrated: one video for each camera, on one clock."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.beside import RECORDED
from streamlod.core.camera import Camera
from streamlod.core.data.video.file import ONE_CLOCK
from streamlod.core.errors import InputError
from streamlod.core.repeating import repeating
from streamlod.server.ingest.board_sight import BoardSight
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.relay import listening
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sound.recorder import SoundRecorder
from streamlod.server.ingest.statistics import SLOW, trouble_of
from streamlod.server.ingest.sync.pace import is_slow
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import CameraState, Instant

_TELL_SECONDS = 5.0
_LATE_SECONDS = 1.5  # that pictures may be on their way after the end
_BUFFERED = 32  # pictures of a camera that may wait to be written
_TICKS = 90_000  # a second, of the files' times
# Each group of pictures is whole on disk before the next one begins: what was filmed outlives this process. The list
# of the file waits for the first picture, whose time it has.
_FILE = {"movflags": "hybrid_fragmented+delay_moov", "flush_packets": "1"}
_ENCODER = {"preset": "ultrafast", "tune": "zerolatency", "crf": "17", "g": "30"}  # as fast as the cameras film


class WatchedRig(Rig):
    """A rig whose pictures are also written down while there are writers for them, paired or not, and its sound.

    Attributes:
        newest: picture of each camera that has sent one.
    """

    def __init__(self, definition: RigDefinition) -> None:
        super().__init__(definition, [camera.name for camera in definition.cameras], self._take_sound)
        self.writers: dict[str, _Writer] = {}
        self.sound: SoundRecorder | None = None
        self.newest: dict[str, Picture] = {}
        self._sights: Mapping[str, BoardSight] = {}  # of the board, while its walk is recorded

    def put(self, picture: Picture) -> None:
        """See `Rig.put`."""
        super().put(picture)
        self.newest[picture.camera] = picture
        if (writer := self.writers.get(picture.camera)) is not None:
            writer.take(picture)

    def sight(self, camera: str) -> BoardSight | None:
        """See `Rig.sight`."""
        return self._sights.get(camera)

    def _take_sound(self, piece: SoundPiece) -> None:
        if (sound := self.sound) is not None:
            sound.take(piece)

    def show(self, sights: Mapping[str, BoardSight]) -> None:
        """Have each pushed camera's page tell what the camera sees and needs of the board."""
        self._sights = sights


@contextmanager
def watching(definition: RigDefinition, push_socket: Path | None) -> Iterator[WatchedRig]:
    """The rig of an uncalibrated definition in operation, with pictures that come at `push_socket`.

    Raises:
        InputError: the socket cannot be made.
    """
    rig = WatchedRig(definition)
    with ExitStack() as stack:
        stack.callback(rig.stop)
        if push_socket is not None and rig.pushed:
            stack.enter_context(listening(push_socket, lambda: Intake(rig)))
        rig.start()
        yield rig


def first_whole(rig: WatchedRig, seconds: float, waiting: Callable[[Mapping[str, str]], None]) -> Instant:
    """The first instant with a picture of every camera.

    Args:
        seconds: to wait at most.
        waiting: told which cameras do not deliver, and why, where that is known, whenever these are others.

    Raises:
        InputError: cameras did not come in time; it names them all.
    """
    timer = threading.Timer(seconds, rig.stop)
    timer.daemon = True
    timer.start()
    try:
        with _telling(rig, waiting):
            for instant in rig.instants():
                if all(picture is not None for picture in instant.pictures):
                    return instant
    finally:
        timer.cancel()
    if missing := _missing(rig):
        raise InputError("rig", f"waited {seconds:.0f} s for {trouble_of(missing)}; have all film and try again")
    raise InputError("rig", f"had no instant with pictures of all cameras within {seconds:.0f} s")


def _telling(rig: WatchedRig, tell: Callable[[Mapping[str, str]], None]) -> AbstractContextManager[None]:
    """Call `tell` with the cameras that do not deliver as they should, and why: a few seconds after this is another.

    What is said again and again would push a phone's QR code out of the terminal.
    """
    told: dict[str, str] | None = None

    def watch() -> None:
        nonlocal told
        rates = {name: camera.rate for name, camera in rig.statistics().cameras.items()}
        slow = {name: rate for name, rate in rates.items() if rate is not None and is_slow(rate, rig.fps)}
        trouble = dict.fromkeys(slow, SLOW) | _missing(rig)
        if trouble != told:  # another rate is no news
            rate = min(slow.values(), default=0.0)
            tell({name: why.format(rate, rig.fps) if why is SLOW else why for name, why in trouble.items()})
        told = trouble

    return repeating(watch, _TELL_SECONDS, "telling")


@dataclass(frozen=True, slots=True)
class RecordedCamera:
    """Pictures of one camera that were written, and those left out because this machine was too slow."""

    pictures: int
    left_out: int


@dataclass(frozen=True, slots=True)
class Recorded:
    """A rig as it was written into a folder.

    Attributes:
        cameras: by name.
        sound_seconds: of the rig's sound; None where it names none.
    """

    cameras: dict[str, RecordedCamera]
    sound_seconds: float | None


def record(
    rig: WatchedRig,
    definition: RigDefinition,
    folder: Path,
    seconds: float,
    missing: Callable[[Mapping[str, str]], None] = lambda _: None,
    look: Callable[[Instant], object] = lambda _: None,
) -> Recorded:
    """Record for so long, until the sources end, a file cannot be written or the user interrupts; the rig stops then.

    The files `NAME.mp4` have one clock: a picture's time is when it was taken, from one beginning for all. So has the
    rig's sound, in `sound.opus`, which is there once something is heard.

    Args:
        missing: told every few seconds which cameras do not deliver as they should, and why.
        look: given each instant; must not wait.

    Raises:
        InputError: a file cannot be written.
    """
    begin_ns = rig.now_ns
    writers = {
        camera.name: _Writer(folder / f"{camera.name}.mp4", camera, definition.fps, begin_ns, seconds, rig.stop)
        for camera in definition.cameras
    }
    for writer in writers.values():
        writer.start()
    sound = None
    (folder / RECORDED).unlink(missing_ok=True)  # of an earlier recording, whose sound is not that of these pictures
    if definition.sound is not None:
        sound = SoundRecorder(folder / RECORDED, begin_ns, seconds, definition.microphone)
    rig.writers, rig.sound = writers, sound
    try:
        go_on(rig, seconds + _LATE_SECONDS, missing, look)
    finally:
        rig.writers, rig.sound = {}, None
        ended = [writer.end() for writer in writers.values()] + ([] if sound is None else [sound.end()])
    for failure in ended:
        if failure is not None:
            raise failure
    cameras = {name: RecordedCamera(writer.count, writer.left_out) for name, writer in writers.items()}
    return Recorded(cameras, None if sound is None else sound.seconds)


def go_on(
    rig: WatchedRig,
    seconds: float | None,
    missing: Callable[[Mapping[str, str]], None] = lambda _: None,
    look: Callable[[Instant], object] = lambda _: None,
) -> None:
    """Film so long, or without end where that is None, until the sources end or the user interrupts. See `record`."""
    timer = threading.Timer(threading.TIMEOUT_MAX if seconds is None else seconds, rig.stop)
    timer.daemon = True
    timer.start()
    try:
        with _telling(rig, missing):
            for instant in rig.instants():
                look(instant)
    except KeyboardInterrupt:
        pass
    finally:
        timer.cancel()


def _missing(rig: Rig) -> dict[str, str]:
    cameras = rig.statistics().cameras
    return {
        name: camera.refused or camera.fault for name, camera in cameras.items() if camera.state is CameraState.LOST
    }


class _Writer(threading.Thread):
    """Writes one camera's video on a thread of its own.

    Args:
        begin_ns: capture time at which the file begins.
        seconds: that it lasts at most.
        failed: called once it cannot be written any more.
    """

    def __init__(
        self, file: Path, camera: Camera, fps: float, begin_ns: int, seconds: float, failed: Callable[[], None]
    ) -> None:
        super().__init__(daemon=True, name=f"record {camera.name}")
        self._file, self._size, self._fps = file, (camera.width, camera.height), fps
        self._begin_ns, self._ticks = begin_ns, round(seconds * _TICKS)
        self._waiting: queue.Queue[Picture | None] = queue.Queue(_BUFFERED)
        self._failure: InputError | None = None
        self._failed = failed
        self.count = self.left_out = 0

    def take(self, picture: Picture) -> None:
        """Have a picture written, unless too many wait; never waits itself."""
        try:
            self._waiting.put_nowait(picture)
        except queue.Full:
            self.left_out += 1

    def end(self) -> InputError | None:
        """Wait until all is written; the fault where something could not be."""
        self._waiting.put(None)
        self.join()
        return self._failure

    def run(self) -> None:
        try:
            self._write_all()
        except (av.FFmpegError, OSError) as error:
            self._failure = InputError(self._file, f"cannot be written ({error.strerror or error})")
            self._failed()
            while self._waiting.get() is not None:  # nobody shall wait for room
                pass

    def _write_all(self) -> None:
        even = self._size[0] % 2 == 0 and self._size[1] % 2 == 0
        with av.open(str(self._file), "w", format="mp4", options=_FILE) as container:
            container.metadata["comment"] = ONE_CLOCK
            stream = container.add_stream("libx264", rate=Fraction(self._fps).limit_denominator(1001), options=_ENCODER)
            stream.width, stream.height = self._size
            stream.pix_fmt = "yuv420p" if even else "yuv444p"
            stream.codec_context.time_base = Fraction(1, _TICKS)
            last = -1
            while (picture := self._waiting.get()) is not None:
                ticks = round((picture.capture_ns - self._begin_ns) * _TICKS / 1e9)
                if not last < ticks < self._ticks:
                    continue
                try:
                    frame = av.VideoFrame.from_ndarray(picture.load(), format="rgb24")
                except InputError:  # a damaged picture
                    continue
                frame.pts, frame.time_base = ticks, Fraction(1, _TICKS)
                container.mux(stream.encode(frame))
                last, self.count = ticks, self.count + 1
            if self.count:
                container.mux(stream.encode())
