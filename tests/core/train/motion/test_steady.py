"""Anchors that training keeps moving."""

from __future__ import annotations

import numpy as np
import torch

from streamlod.core.synthetic import SyntheticSpec, cameras
from streamlod.core.train.motion.steady import mean_motion, moves_steadily

RIG = cameras(SyntheticSpec(cameras=3, width=240, height=136))


def pixel(positions: torch.Tensor) -> torch.Tensor:
    """[N] world units that a pixel of the camera that sees most of a motion is wide, at `positions` [N,3]."""
    widths = []
    for camera in RIG:
        distance = np.linalg.norm(positions.numpy() - camera.centre, axis=1)
        widths.append(distance / camera.intrinsics[0, 0])
    return torch.from_numpy(np.min(widths, axis=0)).float()


def test_what_moves_steadily_is_told_from_what_trembles() -> None:
    positions = torch.tensor([[0.0, 1.0, 0.0], [0.5, 1.0, 0.5], [0.0, 0.5, 1.0], [0.0, 1.0, 0.0]])
    width = pixel(positions)
    motion = None
    for frame in range(40):
        step = torch.zeros(4, 3)
        step[0, 0] = 0.1 * width[0]  # a tenth of a pixel a frame
        step[1, 1] = (0.5 if frame % 2 else -0.5) * width[1]
        step[2, 2] = 0.04 * width[2]
        motion = mean_motion(motion, step)
        if frame == 0:
            assert not moves_steadily(motion, positions, RIG).any()  # a single step is no habit
    assert moves_steadily(motion, positions, RIG).tolist() == [True, False, False, False]


def test_one_large_step_counts_until_it_is_forgotten() -> None:
    positions = torch.tensor([[0.0, 1.0, 0.0]])
    motion = mean_motion(None, torch.tensor([[2.0, 0.0, 0.0]]) * pixel(positions))
    frames = 0
    while moves_steadily(motion, positions, RIG).all():
        motion, frames = mean_motion(motion, torch.zeros(1, 3)), frames + 1
    assert 13 <= frames <= 15  # 0.2 pixels to a twentieth: 0.9^14 is 0.23


def test_nothing_known_is_no_motion() -> None:
    assert moves_steadily(None, torch.zeros(5, 3), RIG).tolist() == [False] * 5
    far = torch.from_numpy(RIG[0].centre).float()[None]  # at a camera's very centre
    assert moves_steadily(torch.zeros(1, 3), far, RIG).tolist() == [False]
