"""A rig that is watched and recorded before it is calibrated: one video for each camera, on one clock."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.beside import RECORDED
from streamlod.core.errors import InputError
from streamlod.core.repeating import repeating
from streamlod.server.ingest.board_sight import BoardSight
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.cameras.video_writer import VideoWriter
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.relay import listening
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sound.recorder import SoundRecorder
from streamlod.server.ingest.statistics import SLOW, trouble_of
from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.ingest.sync.pace import is_slow
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant

_TELL_SECONDS = 5.0
_LATE_SECONDS = 1.5  # that pictures may be on their way after the end


class WatchedRig(Rig):
    """A rig whose pictures are also written down while there are writers for them, paired or not, and its sound.

    Attributes:
        newest: picture of each camera that has sent one.
    """

    def __init__(self, definition: RigDefinition) -> None:
        super().__init__(definition, [camera.name for camera in definition.cameras], self._take_sound)
        self.writers: dict[str, VideoWriter] = {}
        self.sound_recorder: SoundRecorder | None = None
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
        if (recorder := self.sound_recorder) is not None:
            recorder.take(piece)

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
    with _for_seconds(rig, seconds, waiting):
        for instant in rig.instants():
            if all(picture is not None for picture in instant.pictures):
                return instant
    if missing := _missing(rig):
        raise InputError("rig", f"waited {seconds:.0f} s for {trouble_of(missing)}; have all film and try again")
    raise InputError("rig", f"had no instant with pictures of all cameras within {seconds:.0f} s")


@contextmanager
def _for_seconds(rig: WatchedRig, seconds: float | None, tell: Callable[[Mapping[str, str]], None]) -> Iterator[None]:
    """Stop the rig when the context has lasted so long, or never where that is None.

    Meanwhile `tell` is told the cameras that do not deliver as they should, and why, a few seconds after these are
    others: what is said again and again would push a phone's QR code out of the terminal.
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

    timer = threading.Timer(threading.TIMEOUT_MAX if seconds is None else seconds, rig.stop)
    timer.daemon = True
    timer.start()
    try:
        with repeating(watch, _TELL_SECONDS, "telling"):
            yield
    finally:
        timer.cancel()


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
    missing: Callable[[Mapping[str, str]], None],
    look: Callable[[Instant], object],
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
        camera.name: VideoWriter(folder / f"{camera.name}.mp4", camera, definition.fps, begin_ns, seconds, rig.stop)
        for camera in definition.cameras
    }
    for writer in writers.values():
        writer.start()
    sound = None
    (folder / RECORDED).unlink(missing_ok=True)  # of an earlier recording, whose sound is not that of these pictures
    if definition.sound is not None:
        sound = SoundRecorder(folder / RECORDED, begin_ns, seconds, definition.microphone)
    rig.writers, rig.sound_recorder = writers, sound
    try:
        go_on(rig, seconds + _LATE_SECONDS, missing, look)
    finally:
        rig.writers, rig.sound_recorder = {}, None
        ended = [writer.end() for writer in writers.values()] + ([] if sound is None else [sound.end()])
    for failure in ended:
        if failure is not None:
            raise failure
    cameras = {name: RecordedCamera(writer.count, writer.left_out) for name, writer in writers.items()}
    return Recorded(cameras, None if sound is None else sound.seconds)


def go_on(
    rig: WatchedRig,
    seconds: float | None,
    missing: Callable[[Mapping[str, str]], None],
    look: Callable[[Instant], object] = lambda _: None,
) -> None:
    """Film so long, or without end where that is None, until the sources end or the user interrupts. See `record`."""
    with suppress(KeyboardInterrupt), _for_seconds(rig, seconds, missing):
        for instant in rig.instants():
            look(instant)


def _missing(rig: Rig) -> dict[str, str]:
    cameras = rig.statistics().cameras
    return {
        name: camera.refused or camera.fault for name, camera in cameras.items() if camera.state is CameraState.LOST
    }
