"""Calibration of board walks whose truth is known, from their corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.graph import first_poses
from streamlod.core.calibration.known_lens import check_known
from streamlod.core.calibration.report import advice_of
from streamlod.core.calibration.solve import Calibration, calibrate
from streamlod.core.calibration.sound.report import sound_advice
from streamlod.core.calibration.track import Track
from streamlod.core.errors import InputError
from tests.core.calibration.alignment import differences
from tests.core.calibration.walks import BOARD, Rig, board_at, rig, stopping, walked

FPS = 8.0


def poses_of(found: Calibration) -> Float64:
    return np.array([rigid.pose(camera.world_to_camera) for camera in found.cameras])


def known_lenses(truth: Rig) -> dict[str, Float64]:
    return dict(zip(truth.names, truth.lenses, strict=True))


@pytest.mark.long
def test_a_known_lens_of_another_camera_is_refused() -> None:
    truth = rig()
    tele = truth.lenses.copy()
    tele[3, :2] *= 2  # those of the others are too much alike to be told from one small board
    truth = replace(truth, lenses=tele)
    right = known_lenses(truth)
    tracks = walked(truth, fps=FPS, seconds=16)
    check_known(tracks, right, BOARD.corners)
    swapped = right | {"cam_0": right["cam_3"], "cam_3": right["cam_0"]}
    with pytest.raises(InputError, match=r"camera cam_3: its known lens does not fit.*that of cam_0 fits"):
        calibrate(tracks, BOARD, swapped)
    zoomed = {name: np.concatenate([lens[:4] / 4, lens[4:]]) for name, lens in right.items()}
    with pytest.raises(InputError, match=r"camera cam_0: its known lens does not fit.*; it zoomed, or"):
        calibrate(tracks, BOARD, zoomed)
    rare = [
        replace(track, corners=np.where(np.arange(len(track.times))[:, None, None] < 3, track.corners, np.nan))
        for track in tracks
    ]
    check_known(rare, swapped, BOARD.corners)  # too little is seen to tell


def half(track: Track, begin: float, end: float) -> Track:
    """The track with the board hidden outside of a part of its time."""
    length = track.times[-1]
    hidden = (track.times < begin * length) | (track.times > end * length)
    return replace(track, corners=np.where(hidden[:, None, None], np.nan, track.corners))


@pytest.mark.long
def test_poses_lenses_and_offsets_of_distorted_cameras_are_found() -> None:
    truth, rate = rig(), 15.0
    offsets = np.array([0.0, 0.5, -0.35, 0.2]) / rate
    readouts = np.array([0.0, 0.03, 0.015, -0.02])  # of phones, one of which hangs upside down
    found = calibrate(walked(truth, fps=rate, seconds=30, offsets=offsets, readouts=readouts), BOARD)
    degrees, metres = differences(poses_of(found), truth.poses)
    assert degrees.max() < 0.1
    assert metres.max() < 0.002
    assert np.abs(found.offsets - (offsets - offsets[found.root])).max() * rate < 0.1
    np.testing.assert_allclose(found.readouts, np.stack([np.zeros(4), readouts], axis=1), atol=0.002)
    assert found.rms() == pytest.approx(0.15 * np.sqrt(2), rel=0.15)  # nothing but the noise is left
    assert np.abs(np.array([c.intrinsics[0, 0] for c in found.cameras]) / truth.lenses[:, 0] - 1).max() < 0.005


def test_slow_cameras_are_known_as_well_as_is_stated() -> None:
    """At three pictures a second, nobody knows exactly where the board was between them."""
    truth, rate = rig(size=(1280, 960), radius=2.2, arc=100), 3.0
    offsets = np.random.default_rng(0).uniform(-0.5, 0.5, 4) / rate
    found = calibrate(walked(truth, fps=rate, seconds=10, offsets=offsets, seed=0), BOARD)
    degrees, metres = differences(poses_of(found), truth.poses)
    assert degrees.max() < 0.4
    assert metres.max() < 0.008
    assert (degrees < 2 * found.errors[:, 0]).all()
    assert (metres < 2 * found.errors[:, 1]).all()


@pytest.mark.slow
def test_standard_errors_say_how_well_poses_are_known() -> None:
    """Those of all cameras, also where what is wrong is shared by all corners of a picture."""
    truth = rig()
    for shared in (0.0, 0.6):  # pixels that a picture as a whole is off
        tracks = walked(truth, fps=FPS, seconds=20)
        random = np.random.default_rng(3)
        tracks = [replace(t, corners=t.corners + random.normal(0, shared, (len(t.times), 1, 2))) for t in tracks]
        found = calibrate(tracks, BOARD, known_lenses(truth))
        degrees, metres = differences(poses_of(found), truth.poses)
        for off, stated in ((degrees, found.errors[:, 0]), (metres, found.errors[:, 1])):
            assert 0.3 < np.sqrt((off**2).mean() / (stated**2).mean()) < 1.7
            assert (off < 3 * stated).all()


@pytest.mark.long
def test_pictures_with_uneven_times_are_not_taken_for_another_lens() -> None:
    truth = rig(arc=60.0)
    tracks = walked(truth, fps=FPS, seconds=24, uneven=0.005)
    found = calibrate(tracks, BOARD)
    degrees, _ = differences(poses_of(found), truth.poses)
    assert degrees.max() < 0.1
    assert (np.abs(found.uneven - 0.005) < 0.003).all()  # the board takes up some of a camera that saw it alone


@pytest.mark.long
def test_few_corners_that_are_far_less_exact_do_not_outweigh_the_others() -> None:
    """As a detector finds them in pictures: most to a twentieth of a pixel, and one of eight to half of one."""
    truth, random = rig(arc=60.0), np.random.default_rng(2)
    tracks = []
    for track in walked(truth, fps=FPS, seconds=30, noise=0.05, seed=2):
        coarse = random.normal(0, 0.5, track.corners.shape)
        coarse[random.random(coarse.shape[:2]) > 0.125] = 0
        tracks.append(replace(track, corners=track.corners + coarse))
    degrees, metres = differences(poses_of(calibrate(tracks, BOARD)), truth.poses)
    assert degrees.max() < 0.025
    assert metres.max() < 0.0012


@pytest.mark.long
def test_clips_that_began_seconds_apart_are_brought_to_one_time() -> None:
    truth = rig(3)
    offsets = np.array([0.0, 3.04, -2.29])
    found = calibrate(walked(truth, fps=FPS, seconds=16, offsets=offsets), BOARD, known_lenses(truth))
    assert np.abs(found.offsets - (offsets - offsets[found.root])).max() * FPS < 0.1


@pytest.mark.long
def test_an_offset_that_a_board_held_still_does_not_tell_stays_as_sound_has_it() -> None:
    truth, offsets = rig(2, arc=40.0), np.array([0.0, 2.1])
    heard = offsets + np.array([0.0, 0.004])
    found = calibrate(stopping(truth, offsets), BOARD, known_lenses(truth), heard)
    assert found.offsets[1] - found.offsets[0] == pytest.approx(2.104)
    (told,) = sound_advice(found)
    assert "the offset is that of sound, good to 3 ms a metre" in told


@pytest.mark.long
def test_an_offset_that_only_a_board_held_still_tells_is_said_to_be_unsure() -> None:
    truth, offsets = rig(2, arc=40.0), np.array([0.0, 0.1])
    found = calibrate(stopping(truth, offsets), BOARD, known_lenses(truth))
    (told,) = (each for each in advice_of(found) if "the offset may be wrong by a frame or more" in each)
    assert told.startswith(found.cameras[1 - found.root].name)
    moving = calibrate(walked(truth, fps=FPS, seconds=16, offsets=offsets), BOARD, known_lenses(truth))
    assert not moving.guessed.any()


@pytest.mark.long
def test_upside_down_and_sideways_cameras_are_ordinary() -> None:
    truth = rig()
    turns = np.radians([180.0, 0.0, 90.0, 0.0])
    about_z = np.stack([np.zeros(4), np.zeros(4), turns, *np.zeros((3, 4))], axis=1)
    truth = replace(truth, poses=rigid.after(about_z, truth.poses), size=(640, 640))
    found = calibrate(walked(truth, fps=FPS, seconds=12), BOARD, known_lenses(truth))
    assert differences(poses_of(found), truth.poses)[0].max() < 0.1
    heights = np.array([camera.centre[2] for camera in found.cameras])
    assert np.abs(np.diff(heights) - 0.15).max() < 0.05  # z is up although two cameras are not upright


@pytest.mark.long
def test_a_board_that_lay_on_the_floor_is_the_floor() -> None:
    truth = rig()

    def boards(times: Float64) -> Float64:
        lying = np.concatenate([rigid.pose(np.diag([1.0, -1.0, -1.0, 1.0]))[:3], [-0.2, 0.1, 0.0]])
        return np.where((times > 12)[:, None], lying, board_at(times))

    found = calibrate(walked(truth, fps=FPS, seconds=15, boards=boards), BOARD, known_lenses(truth))
    assert found.floor_by_board
    heights = np.array([camera.centre[2] for camera in found.cameras])
    assert np.abs(heights - [1.6, 1.75, 1.9, 2.05]).max() < 0.01


def test_cameras_that_never_see_the_board_together_are_named() -> None:
    tracks = walked(rig(), fps=FPS, seconds=16)
    parted = [*(half(track, 0, 0.45) for track in tracks[:3]), half(tracks[3], 0.55, 1)]
    never = (
        r"camera cam_3: saw the board together with cam_0, cam_1 and cam_2 never, and 5 are needed; hold the board wh"
    )
    with pytest.raises(InputError, match=never):
        calibrate(parted, BOARD, known_lenses(rig()))
    parted[2] = half(tracks[2], 0.55, 1)
    with pytest.raises(InputError, match=r"cameras cam_[0-3] and cam_[0-3]: saw the board together with"):
        calibrate(parted, BOARD, known_lenses(rig()))


@pytest.mark.parametrize("run", [4, 16], ids=["half a second each", "two seconds each"])
def test_cameras_that_saw_the_board_in_turn_are_not_joined_by_chance(run: int) -> None:
    """At a wrong offset of clocks, two halves of a smooth walk lie alike."""
    truth = rig(2, arc=60.0)
    one, other = walked(truth, fps=FPS, seconds=20)
    turn = (np.arange(len(one.times)) // run % 2 == 1)[:, None, None]
    one = replace(one, corners=np.where(turn, np.nan, one.corners))
    other = replace(other, corners=np.where(turn, other.corners, np.nan))
    with pytest.raises(InputError, match=r"camera cam_1: saw the board together with cam_0 never, and 5 are needed"):
        calibrate([one, other], BOARD, known_lenses(truth))


@pytest.mark.parametrize(
    ("width", "pace", "run", "cause"),
    [
        (640, 1.0, 7, r"in cam_\d its squares are ([6-9]|1[012]) pixels wide then, and 13 are needed; come nearer"),
        (1280, 1.0, 1, r"in cam_\d it moves so fast that it is lost at once then, too fast; walk slower"),
        (1280, 4.0, 3, r"in cam_\d it moves by \d+ squares a second then, too fast; walk slower, with more light"),
        (1280, 0.3, 7, r"hold the board where both see it"),
    ],
    ids=["small", "lost at once", "fast", "neither"],
)
def test_why_a_camera_never_saw_the_board_together_with_others_is_told(
    width: int, pace: float, run: int, cause: str
) -> None:
    """One camera and the others see it in turn, some pictures each."""
    truth = rig(size=(width, 3 * width // 4))
    tracks = walked(truth, fps=FPS, seconds=16, boards=lambda times: board_at(pace * times))
    turn = (np.arange(len(tracks[3].times)) // run % 2 == 1)[:, None, None]
    in_turn = [replace(each, corners=np.where(turn, np.nan, each.corners)) for each in tracks[:3]]
    in_turn.append(replace(tracks[3], corners=np.where(turn, tracks[3].corners, np.nan)))
    with pytest.raises(InputError, match=rf"cam_3: saw the board together with .* never, and 5 are .*; {cause}"):
        first_poses(in_turn, np.zeros(4), tracks[0].times, truth.lenses, BOARD.corners)


def test_a_camera_that_saw_the_board_too_rarely_is_named() -> None:
    tracks = walked(rig(), fps=FPS, seconds=15)
    with pytest.raises(InputError, match=r"camera cam_2: saw the board in [0-5] of 120 pictures well enough"):
        calibrate([*tracks[:2], half(tracks[2], 0.5, 0.53), tracks[3]], BOARD)


@pytest.mark.long
@pytest.mark.parametrize("when", ["last", "first"])
def test_a_camera_that_was_knocked_during_the_walk_is_named(when: str) -> None:
    """By four degrees, for so short a time that what it saw then would pass for a few outliers."""
    truth, seconds = rig(), 16.0
    turned = truth.poses.copy()
    turned[2] = rigid.after(np.array([0, np.radians(4), 0, 0, 0, 0]), truth.poses[2:3])[0]

    def boards(times: Float64) -> Float64:
        return board_at(times if when == "last" else seconds - times)

    still = walked(truth, fps=FPS, seconds=seconds, boards=boards)
    moved = walked(replace(truth, poses=turned), fps=FPS, seconds=seconds, boards=boards)[2]
    knocked = moved.times > 0.85 * seconds if when == "last" else moved.times < 0.15 * seconds
    still[2] = replace(moved, corners=np.where(knocked[:, None, None], moved.corners, still[2].corners))
    with pytest.raises(InputError, match=f"camera cam_2: (was knocked|does not agree with the others at the {when})"):
        calibrate(still, BOARD, known_lenses(truth))


@pytest.mark.long
def test_a_camera_that_was_turned_in_the_midst_of_a_walk_is_named() -> None:
    """Lenses and boards can take up what it saw before and after, so that nothing looks far off."""
    truth, seconds = rig(3, arc=50.0), 24.0
    turned = truth.poses.copy()
    turned[1] = rigid.after(np.array([0, np.radians(2.5), 0, 0, 0, 0]), truth.poses[1:2])[0]
    still = walked(truth, fps=FPS, seconds=seconds, noise=0.03)
    moved = walked(replace(truth, poses=turned), fps=FPS, seconds=seconds, noise=0.03)[1]
    late = moved.times > 0.55 * seconds
    still[1] = replace(moved, corners=np.where(late[:, None, None], moved.corners, still[1].corners))
    with pytest.raises(InputError, match=r"camera cam_1: was knocked or turned during the walk, after about [0-9]+ %"):
        calibrate(still, BOARD)


@pytest.mark.long
def test_a_video_of_another_walk_is_named() -> None:
    truth = rig()
    tracks = walked(truth, fps=FPS, seconds=16)
    other = walked(truth, fps=FPS, seconds=16, boards=lambda times: board_at(1.37 * times + 50))
    with pytest.raises(InputError, match="camera cam_1: "):
        calibrate([tracks[0], other[1], *tracks[2:]], BOARD, known_lenses(truth))
