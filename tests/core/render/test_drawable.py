"""What gsplat cannot draw, or should not, is moved out of sight before it meets it; against the reference's rules."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from streamlod.core.camera import pinhole
from streamlod.core.render.drawable import DeviceCamera, device_camera, drawable
from streamlod.core.render.reference import rotation
from tests.core.render.scenes import NAMES
from tests.core.render.test_extremes import CAMERA, CULLED, ODD, odd


@pytest.mark.parametrize(("name", "value"), CULLED)
def test_what_gsplat_cannot_draw_is_moved_out_of_sight(name: str, value: float) -> None:
    leaves = [torch.tensor(getattr(odd(name, value), n), requires_grad=True) for n in NAMES]
    seen = device_camera(CAMERA, torch.device("cpu"))
    found = drawable(leaves, seen)
    kept = slice(ODD.stop, None)
    weak = name == "opacities" and math.isfinite(value)  # gsplat itself leaves those out
    for old, new in zip(leaves, found, strict=True):
        assert torch.isfinite(new).all()
        assert torch.equal(new[kept], old[kept])
    assert (found[0][ODD] == seen.centre).all(dim=1).all() != weak
    torch.stack([part.sum() for part in found]).sum().backward()
    for leaf in leaves:
        assert leaf.grad is not None
        assert (leaf.grad[kept] == 1).all()
        assert weak or not leaf.grad[ODD].any()


def marking(
    focal: tuple[float, float], middle: tuple[float, float], size: tuple[int, int], pose: NDArray[np.float64]
) -> DeviceCamera:
    """A camera which moves what is out of sight to (7, 7, 7)."""
    seen = device_camera(pinhole("marking", focal, middle, size, pose), torch.device("cpu"))
    return replace(seen, centre=torch.full((3,), 7.0))


def test_what_lies_far_beside_the_picture_is_moved_out_of_sight() -> None:
    seen = marking((10, 10), (8, 6), (16, 12), np.eye(4))
    aside = torch.tensor([0.99, 1.01])  # picture sizes from the middle
    means = torch.cat(
        [
            torch.stack([aside * 1.6, 0 * aside, 1 + 0 * aside], 1),
            torch.stack([0 * aside, -aside * 1.2, 1 + 0 * aside], 1),
        ]
    )
    parts = [means, torch.ones(4, 4), 0.1 * torch.ones(4, 3), torch.ones(4), torch.ones(4, 3)]
    found = drawable(parts, seen)
    assert (found[0] == 7).all(dim=1).tolist() == [False, True, False, True]
    assert found[3].tolist() == [1, 0, 1, 0]


def test_what_reaches_far_along_the_view_is_moved_out_of_sight() -> None:
    """Against the reference's rotation: half of the depth is the most."""
    generator = torch.Generator().manual_seed(0)
    quaternions, scales = torch.randn(50, 4, generator=generator), torch.rand(50, 3, generator=generator)
    pose = torch.eye(4)
    pose[:3, :3] = rotation(torch.randn(1, 4, generator=generator))[0]
    spread = ((pose[2, :3] @ rotation(quaternions)) * scales).norm(dim=-1)
    beyond = torch.arange(50) % 2
    at_camera = torch.stack([torch.zeros(50), torch.zeros(50), 2 * spread * (1.01 - 0.02 * beyond)], 1)
    parts = [at_camera @ pose[:3, :3], quaternions, scales, torch.ones(50), torch.ones(50, 3)]
    found = drawable(parts, marking((1, 1), (0, 0), (2, 2), pose.double().numpy()))
    assert torch.equal((found[0] == 7).all(dim=1).long(), beyond)
    assert torch.equal(found[3].long(), 1 - beyond)


def test_strong_opacities_are_held_and_keep_their_gradient() -> None:
    opacities = torch.tensor([0.5, 2.0, 50.0], requires_grad=True)
    others = torch.ones(3, 3)
    parts = [others, torch.ones(3, 4), 0.1 * others, opacities, others]
    held = drawable(parts, marking((1, 1), (0, 0), (2, 2), np.eye(4)))[3]
    assert held.tolist() == [0.5, 2.0, 2.0]
    held.sum().backward()
    assert opacities.grad is not None
    assert opacities.grad.tolist() == [1, 1, 1]
