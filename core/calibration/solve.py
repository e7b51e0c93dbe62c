"""From tracks of a board walk to calibrated cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.adjust import Adjusted, Known, adjust
from streamlod.core.calibration.adjustment.observations import Observations, observed
from streamlod.core.calibration.adjustment.projection import matrix_of
from streamlod.core.calibration.adjustment.residuals import AdjustedRig, misses_of
from streamlod.core.calibration.adjustment.timing import UnevenTimes, uneven_times
from streamlod.core.calibration.apart import in_turn
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.first_lens import first_lens
from streamlod.core.calibration.graph import first_poses
from streamlod.core.calibration.instants import chosen_instants, independent
from streamlod.core.calibration.known_lens import check_known
from streamlod.core.calibration.stillness import check_still
from streamlod.core.calibration.sync import first_offsets
from streamlod.core.calibration.track import Track
from streamlod.core.calibration.trust import check_agreement, check_certainty, check_lens, near_enough
from streamlod.core.calibration.world import find_floor
from streamlod.core.camera import Camera
from streamlod.core.data.lens import opencv_camera
from streamlod.core.errors import InputError

_MAX_ROUNDS = 6  # after the first: outliers left out, and curves about the pictures nearest by the offsets found
_WEIGHED = 2  # first of these, in which it is measured how uneven times are: in more, one camera's would count alone
_SETTLED = 0.01  # of the period between pictures, by which no offset changes any more


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated rig.

    Attributes:
        cameras: with distortion, world to camera in metres, z up.
        root: number of the camera whose clock is the common one.
        offsets: [C] seconds to add to each camera's clock to get the root's.
        readouts: [C,2] seconds that each camera takes to read a picture from left to right, and from top to bottom.
        periods: [C] seconds between each camera's pictures.
        errors: [C,2] standard errors of directions in degrees and of places in metres, in the rig as a whole.
        uneven: [C] standard deviation of each camera's times, in seconds.
        heard: [C] offsets to some common clock by sound, in seconds; NaN where unknown.
        by_sound: [C] whether a camera's offset rests on sound, as the board does not determine it.
        guessed: [C] whether it rests on nothing but a board held still.
        floor_by_board: whether the board lay on the floor; else up is as the cameras are held.
        times: [I] common seconds of the instants used.
        boards: [I,3] the board's centre at these, in the world.
        seen: the corners used. misses: [N,2] their reprojection errors, less the part that uneven times explain.
    """

    cameras: tuple[Camera, ...]
    root: int
    offsets: Float64
    readouts: Float64
    periods: Float64
    errors: Float64
    uneven: Float64
    heard: Float64
    by_sound: Bool
    guessed: Bool
    floor_by_board: bool
    times: Float64
    boards: Float64
    seen: Observations
    misses: Float64

    def rms(self, camera: int | None = None) -> float:
        """Root mean square of the distances in pixels, of one camera or all."""
        rows = slice(None) if camera is None else self.seen.camera == camera
        return float(np.sqrt((self.misses[rows] ** 2).sum(axis=1).mean()))

    def median(self, camera: int | None = None) -> float:
        """Median of the distances in pixels, of one camera or all."""
        rows = slice(None) if camera is None else self.seen.camera == camera
        return float(np.median(np.linalg.norm(self.misses[rows], axis=1)))


def calibrate(
    tracks: Sequence[Track],
    board: Board,
    known: Mapping[str, Float64] | None = None,
    heard: Float64 | None = None,
) -> Calibration:
    """The rig whose cameras saw `tracks`.

    Args:
        known: lenses [9] by camera that are kept.
        heard: [C] seconds to add to each camera's clock to get some common one, by sound; NaN where unknown, None
            without sound.

    Raises:
        InputError: a camera that saw too little, does not agree with the others, or has another lens than is known; it
            is named.
    """
    names, known = [track.camera for track in tracks], known or {}
    heard = np.full(len(tracks), np.nan) if heard is None else heard
    check_known(tracks, known, board.corners)
    fixed = np.array([name in known for name in names])
    lenses = np.array([known[t.camera] if t.camera in known else first_lens(t, board.corners) for t in tracks])
    try:
        return _placed(tracks, board, lenses, fixed, heard)
    except InputError as refusal:
        cause = in_turn(tracks, np.nan_to_num(heard), board.corners)
        if cause is not None:  # what was refused is a wrong offset of clocks, at which paths lay alike by chance
            raise cause from refusal
        raise


def _placed(tracks: Sequence[Track], board: Board, lenses: Float64, fixed: Bool, heard: Float64) -> Calibration:
    """The rig from first `lenses` [C,9], of which those `fixed` [C] stay."""
    names = [track.camera for track in tracks]
    clocks = first_offsets(tracks, lenses, board.corners, board.centre, heard)
    times = chosen_instants(tracks, clocks.seconds)
    first = first_poses(tracks, clocks.seconds, times, lenses, board.corners)
    apart = independent(tracks, times)
    check_still(names, [view[apart] for view in first.views])
    placed = np.isfinite(first.boards[:, 0])
    times = times[placed]
    scene = AdjustedRig(lenses, first.cameras, clocks.seconds, np.zeros((len(tracks), 2)), first.boards[placed])
    root = first.root
    found, corners, uneven = _adjusted(tracks, times, scene, board, Known(root, fixed, clocks.held(root)))
    check_certainty(names, found, corners)
    scene = found.scene
    floor = find_floor(scene.cameras, scene.boards, times, board.centre)
    poses = rigid.after(scene.cameras, rigid.inverse(floor.to_world))
    cameras = [
        opencv_camera(track.camera, matrix_of(lens), rigid.matrix(pose), track.size, lens[4:].copy())
        for track, lens, pose in zip(tracks, scene.lenses, poses, strict=True)
    ]
    for camera in cameras:
        check_lens(camera, "where it saw the board; walk the board through all of its picture")
    centre = np.concatenate([np.zeros(3), board.centre])
    return Calibration(
        cameras=tuple(cameras),
        root=root,
        offsets=scene.offsets - scene.offsets[root],
        readouts=scene.readouts,
        periods=np.array([track.period for track in tracks]),
        errors=found.errors * [np.degrees(1), 1],
        uneven=uneven.seconds,
        heard=heard,
        by_sound=clocks.by_sound(root),
        guessed=clocks.guessed(root),
        floor_by_board=floor.by_board,
        times=times,
        boards=rigid.after(floor.to_world, rigid.after(scene.boards, centre))[:, 3:],
        seen=corners,
        misses=found.misses,
    )


def _adjusted(
    tracks: Sequence[Track], times: Float64, scene: AdjustedRig, board: Board, known: Known
) -> tuple[Adjusted, Observations, UnevenTimes]:
    """The best scene, the corners that it explains, and how uneven the cameras' times are."""
    names, sizes = [track.camera for track in tracks], [track.size for track in tracks]
    corners = observed(tracks, times, scene.offsets, board.corners)
    found = adjust(scene, corners, sizes, known)
    check_agreement(names, corners, found.misses)
    for number in range(_MAX_ROUNDS):
        before = found.scene.offsets
        corners = observed(tracks, times, found.scene.offsets, board.corners)
        misses = misses_of(found.scene, corners)
        if number < _WEIGHED:
            uneven = uneven_times(corners, misses, len(tracks))
        at_start = uneven.weights(corners).of_misses(misses)
        corners = corners.kept(near_enough(at_start, corners.camera))
        found = adjust(found.scene, corners, sizes, known, uneven)
        if np.abs(found.scene.offsets - before).max() < _SETTLED * min(track.period for track in tracks):
            break
    return found, corners, uneven
