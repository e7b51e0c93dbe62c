"""A live rig as a data set: frame sets as they come, for training.

Pixels are converted just before training asks for them, and only for instants that are used.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.core.arrays import Bool, UInt8
from streamlod.core.camera import Camera
from streamlod.core.camera.grid import period_of
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.data.lens import Undistortion, undistortions
from streamlod.core.data.placed import PlacedCameras
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.server.ingest.ahead import just_in_time
from streamlod.server.ingest.cameras.definition import RigDefinition, read_definition
from streamlod.server.ingest.knocks import Knocks
from streamlod.server.ingest.poses import PoseWatch
from streamlod.server.ingest.push.intake import Intake
from streamlod.server.ingest.push.relay import listening
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sound.listening import CameraEar
from streamlod.server.ingest.statistics import Statistics
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant

_Undistorted = tuple[Instant, UInt8, Bool]  # an instant, its pictures' pixels [C,H,W,3], which cameras [C] have one


@dataclass(eq=False)
class LiveDataset(PlacedCameras):
    """A live rig in place of a data set: cameras, and frames as they come.

    Attributes:
        definition: of the rig.
        push_socket: where to take pictures that the serving process relays, while frames are read; or none.
        give_sound: takes the rig's sound as it comes, while frames are read; or none.
        listeners: take what cameras hear meanwhile, see `Rig`.
        undistortions, space, cameras: as in `PlacedCameras`.
        rig: in operation, which takes pushed pictures; None while nothing is read.
    """

    definition: RigDefinition
    undistortions: tuple[Undistortion, ...]
    push_socket: Path | None = None
    give_sound: Callable[[SoundPiece], None] | None = None
    listeners: Mapping[str, CameraEar] = field(default_factory=dict)
    space: Similarity = UNCHANGED
    cameras: tuple[Camera, ...] = field(init=False)
    frame_count: None = field(init=False, default=None)  # endless
    rig: Rig | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.cameras = self.placed_cameras

    @property
    def calibration(self) -> RigDefinition:
        """See `PlacedCameras`."""
        return self.definition

    @property
    def fps(self) -> float:
        """Instants a second."""
        return self.definition.fps

    def normalised(self) -> LiveDataset:
        """The same rig in the space of training, see `Dataset.normalised`."""
        return self.placed(self.definition.space)

    def placed(self, space: Similarity) -> LiveDataset:
        """The same rig in another space, to which `space` leads from the calibration's coordinates."""
        return replace(self, space=space)

    def select(self, names: Sequence[str]) -> LiveDataset:
        """The same rig with the cameras `names` only, in that order; others are not read.

        A quorum shrinks by the cameras left out.

        Raises:
            InputError: a name that does not exist, or given twice.
        """
        return replace(self, undistortions=tuple(self.undistortions[row] for row in self.rows_of(names)))

    def frames(self, start: int = 0, stop: int | None = None) -> Generator[FrameSet]:
        """Frame sets as they come, numbered from `start` without gaps, up to `stop` or until the sources end.

        Reading begins with the first `next`, and ends when the iterator is closed or dropped. `time_ns` always
        increases, by multiples of a period, even when the cameras' clocks are stepped.

        Raises:
            ValueError: negative numbers, or the rig is being read already.
            InputError: while iterating, where files end without one instant, and one of them is at fault.
        """
        if start < 0 or (stop is not None and stop < start):
            raise ValueError(f"frames {start} to {stop} do not exist")
        if self.rig is not None:
            raise ValueError("the rig is being read already; close its frames first")
        return self._frames(start, stop)

    def close(self) -> None:
        """Stop reading frames; may be called from any thread."""
        if (rig := self.rig) is not None:
            rig.stop()

    def statistics(self) -> Statistics | None:
        """Figures of cameras and delivery; None while nothing is read."""
        rig = self.rig
        return None if rig is None else rig.statistics()

    def _frames(self, start: int, stop: int | None) -> Generator[FrameSet]:
        index = start
        if stop is not None and index >= stop:
            return
        rig = Rig(self.definition, self.names, self.give_sound, self.listeners)
        with ExitStack() as stack:
            stack.callback(self._release)
            stack.callback(rig.stop)
            pool = stack.enter_context(ThreadPoolExecutor(min(len(self.cameras), os.cpu_count() or 1), "undistort"))
            if self.push_socket is not None and rig.pushed:
                stack.enter_context(listening(self.push_socket, lambda: Intake(rig)))
            self.rig = rig  # only now does it take what is pushed
            rig.start()
            instants = rig.instants()

            def undistort() -> _Undistorted | None:
                undistorted = (self._undistorted(rig, instant, pool) for instant in instants)
                return next((found for found in undistorted if found[2].any()), None)

            found: Iterator[_Undistorted] = iter(undistort, None)
            if self.definition.realtime:
                found = stack.enter_context(closing(just_in_time(undistort, lambda _: rig.note_stale())))
            first: Instant | None = None
            knocks, poses = Knocks(len(self.cameras)), PoseWatch(self.undistortions, rig.findings.note_poses)
            while index != stop:
                rig.waiting = True
                newest = next(found, None)
                rig.waiting = False
                if newest is None:
                    if (failure := rig.failure()) is not None:
                        raise failure
                    return
                instant, images, present = newest
                if index == 0 and self.definition.realtime and poses.is_to_be_put_right(images, present, pool):
                    rig.note_stale()
                    continue
                latency_ns = rig.note_delivery(instant)
                first = instant if first is None else first
                time_ns = first.capture_ns + round((instant.number - first.number) * period_of(self.fps))
                knocks.look(images, present, pool)
                rig.findings.note_shifts(knocks.shifts, knocked := knocks.knocked)
                if (present & ~knocked).any():  # a knocked camera shows what is not where its pose says
                    present = present & ~knocked
                poses.look(images, present, pool, tuple(rig.holders.claims().values()))
                yield FrameSet(index, time_ns, images, present, latency_ns)
                index += 1

    def _undistorted(self, rig: Rig, instant: Instant, pool: ThreadPoolExecutor) -> _Undistorted:
        """The instant with its pictures' pixels, and which cameras have one."""
        height, width = self.cameras[0].height, self.cameras[0].width
        images = np.zeros((len(self.cameras), height, width, 3), np.uint8)

        def one(plan: Undistortion, picture: Picture | None, into: UInt8) -> bool:
            if picture is None:
                return False
            try:
                into[:] = plan(picture.load())
            except InputError as error:
                rig.findings.note_decoded(picture.camera, error.fault)
                return False
            rig.findings.note_decoded(picture.camera)
            return True

        present = list(pool.map(one, self.undistortions, instant.pictures, images))
        return instant, images, np.array(present, np.bool_)

    def _release(self) -> None:
        self.rig = None


def open_live(
    source: Path | dict[str, Any],
    *,
    downscale: float = 1,
    push_socket: Path | None = None,
    give_sound: Callable[[SoundPiece], None] | None = None,
) -> LiveDataset:
    """The rig that a file or a mapping describes, its pictures made smaller by `downscale`.

    Pushed pictures come through a `RelayedIntake` to `push_socket`, or from an `Intake(dataset.rig)` in this process.
    Its sound goes to `give_sound`, where somebody wants it.

    Raises:
        InputError: see `read_definition`; a file that is not there, pictures of different shapes, a distortion that
            cannot be undone, or a downscale below 1.
    """
    definition = read_definition(source)
    for camera, address in zip(definition.cameras, definition.addresses, strict=True):
        if not address.is_live and (not Path(address.url).exists() or Path(address.url).is_dir()):
            raise InputError(f"camera {camera.name}", f"there is no file {address.url}")
    if not 1 <= downscale <= 64:
        raise InputError("downscale", f"must lie between 1 and 64, not {downscale}")
    return LiveDataset(definition, undistortions(definition.cameras, downscale), push_socket, give_sound)
