"""Motion in space from motion in pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.train.motion.optical_flow import AnchorFlow
from streamlod.core.train.motion.scene_flow import flow_error, projection_jacobians, scene_flow
from tests.core.train.motion.moved import RIG
from tests.core.train.motion.test_optical_flow import camera_pixels

POSITION = torch.tensor([[0.0, 1.5, 1.0], [0.4, 2.0, 0.8], [-0.5, 1.2, 1.4]])
JACOBIAN = projection_jacobians(POSITION, RIG)
MOTION = torch.tensor([[0.05, 0.0, 0.02], [0.0, 0.06, -0.03], [-0.04, 0.02, 0.05]])


def flow_of(motion: torch.Tensor) -> AnchorFlow:
    """What each camera sees of small motions, to the first order."""
    return AnchorFlow(torch.full(JACOBIAN.shape[:2], 4.0), torch.einsum("cnij,nj->cni", JACOBIAN, motion))


def test_jacobians_are_those_of_the_projection() -> None:
    jacobian = projection_jacobians(POSITION.double(), RIG).numpy()
    step = 1e-5
    for number, camera in enumerate(RIG):
        for axis in range(3):
            away = np.eye(3)[axis] * step
            ends = (camera_pixels(camera, POSITION.double().numpy() + sign * away) for sign in (1, -1))
            slope = np.subtract(*ends) / (2 * step)
            np.testing.assert_allclose(jacobian[number, :, :, axis], slope, rtol=1e-5, atol=1e-5)


def test_motion_is_found_again() -> None:
    found = scene_flow(JACOBIAN, flow_of(MOTION))
    assert flow_error(found, JACOBIAN, flow_of(MOTION)).max() < 0.3  # of 3 to 5 pixels
    assert (found - MOTION).norm(dim=1).max() < 0.3 * MOTION.norm(dim=1).min()  # along the line of sight
    assert flow_error(MOTION, JACOBIAN, flow_of(MOTION)).max() < 1e-3
    still = flow_error(torch.zeros_like(MOTION), JACOBIAN, flow_of(MOTION))
    torch.testing.assert_close(still, flow_of(MOTION).flow.norm(dim=2).mean(dim=0))


def test_a_camera_that_disagrees_is_doubted() -> None:
    right = flow_of(MOTION)
    flow = right.flow.clone()
    flow[2] += torch.tensor([9.0, -6.0])
    found = scene_flow(JACOBIAN, replace(right, flow=flow))
    wrong = torch.einsum("cnij,nj->cni", JACOBIAN, found - MOTION).norm(dim=2)[[0, 1, 3]]
    assert wrong.max() < 1.2  # pixels, where the mean of all four would be wrong by about two and a half


def test_one_camera_says_nothing_of_motion_along_its_line_of_sight() -> None:
    right = flow_of(MOTION)
    seen = torch.zeros_like(right.seen)
    seen[0] = 1.0
    found = scene_flow(JACOBIAN, replace(right, seen=seen))
    sight = torch.nn.functional.normalize(POSITION - torch.from_numpy(RIG[0].centre).float(), dim=1)
    along = (found * sight).sum(dim=1).abs()
    assert (along < 0.05 * found.norm(dim=1)).all()


@pytest.mark.parametrize("seen", [0.0, 1e-30])
def test_what_no_camera_sees_stays(seen: float) -> None:
    right = flow_of(MOTION)
    found = scene_flow(JACOBIAN, replace(right, seen=torch.full_like(right.seen, seen)))
    assert found.isfinite().all()
    assert found.abs().max() < 1e-6
