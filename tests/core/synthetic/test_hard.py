"""The hard clip: each thing that is hard to follow is there, moves as it should, and is masked."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.synthetic import SyntheticSpec, cameras, ground_truth, moving_surface, surface_motion
from streamlod.core.synthetic.kinds.hard import KIND
from streamlod.core.synthetic.parts import Part

PARTS = {"ball": 0, "cloth": slice(16, 64), "globe": 64, "box": 65, "parcel": -2, "door": -1}


def spec(speed: float) -> SyntheticSpec:
    return SyntheticSpec(kind="hard", cameras=5, frames=100, width=240, height=136, noise=0.0, speed=speed)


def part(name: str, time: float) -> Part:
    found = KIND.moving(time, 4.0, 0.0)[PARTS[name]]
    assert isinstance(found, Part)
    return found


def turned_by(name: str, start: float, stop: float) -> float:
    """Radians that a part turns."""
    first, second = part(name, start).rotation, part(name, stop).rotation
    assert first is not None
    assert second is not None
    return float(np.arccos(np.clip((np.trace(first.T @ second) - 1) / 2, -1, 1)))


def went(name: str, start: float, stop: float) -> Float64:
    return np.asarray(part(name, stop).place - part(name, start).place, np.float64)


def test_the_ball_rolls_at_a_metre_a_second_and_spins() -> None:
    assert np.linalg.norm(went("ball", 0.0, 0.1)) == pytest.approx(0.1)
    assert turned_by("ball", 0.0, 0.1) > 0.5  # 0.5 of rolling alone


def test_two_things_cross() -> None:
    sides = [np.sign(part("globe", t).place[0] - part("box", t).place[0]) for t in (0.0, 3.0)]
    assert sides[0] != sides[1]
    assert abs(part("globe", 0.0).place[2] - part("box", 0.0).place[2]) < 0.01


def test_the_parcel_comes_in_through_the_edge_and_the_door_opens() -> None:
    rig = cameras(spec(1.0))
    seen = []
    for time in (0.0, 2.2):
        x, _, z = rig[0].world_to_camera[:3, :3] @ (part("parcel", time).place - rig[0].centre)
        seen.append(x / z * rig[0].intrinsics[0, 0] + rig[0].width / 2)
    assert seen[0] > rig[0].width - 5
    assert seen[1] < rig[0].width - 40
    assert turned_by("door", 0.0, 1.7) > 1.5


def test_every_patch_of_the_cloth_moves() -> None:
    now, later = KIND.moving(1.0, 4.0, 0.0), KIND.moving(1.05, 4.0, 0.0)
    moved = [np.linalg.norm(b.place - a.place) for a, b in zip(now[16:64], later[16:64], strict=True)]
    assert len(moved) == 48
    assert np.median(moved) > 2e-3


@pytest.mark.parametrize("speed", [1.0, 4.0, 12.0])
def test_speed_is_that_of_the_ball_in_pixels_a_frame(speed: float) -> None:
    clip = spec(speed)
    camera = cameras(clip)[0]
    nearer = KIND.rig.radius / (part("ball", 0.0).place[1] + 1.5)
    here, there = (camera.intrinsics @ (camera.world_to_camera @ (*part("ball", clip.time_of(i)).place, 1.0))[:3]
                   for i in (0, 1))  # fmt: skip
    assert np.linalg.norm(there[:2] / there[2] - here[:2] / here[2]) == pytest.approx(speed * nearer, rel=0.15)
    mask = moving_surface(clip, 5, camera)
    assert 0.03 < mask.mean() < 0.5
    assert np.array_equal(mask, ground_truth(clip, 5, 0).moving)
    moved = surface_motion(clip, 5, camera)
    assert np.percentile(moved[moved > 0], 75) > 0.2 * speed  # not the ball alone
