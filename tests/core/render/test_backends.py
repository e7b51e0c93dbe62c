"""Choosing a backend, and saying in one sentence why one is missing."""

import importlib.machinery
import importlib.util
import math
import shutil

import pytest
import torch

from core.errors import BackendUnavailable
from core.render import select
from core.render.backends import cuda_fault
from core.render.cuda import sound
from core.render.reference import rotation
from tests.core.render.scenes import NAMES, make_camera, make_cloud, run
from tests.core.render.test_extremes import CAMERA, CULLED, ODD, odd


@pytest.fixture(autouse=True)
def _fresh() -> None:
    cuda_fault.cache_clear()


def test_cpu_is_always_there() -> None:
    assert select("cpu") == "cpu"


def test_auto_falls_back_to_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert select() == "cpu"
    with pytest.raises(BackendUnavailable, match=r"no CUDA device: .* or choose the device cpu$"):
        select("cuda")
    with pytest.raises(BackendUnavailable, match="no CUDA device"):
        run(make_cloud(3), make_camera(), "cuda")


def test_each_missing_part_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    present = {"torch"}
    spec = importlib.machinery.ModuleSpec("gsplat", None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec if name in present else None)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(BackendUnavailable, match="install gsplat"):
        select("cuda")
    present.add("gsplat")
    cuda_fault.cache_clear()
    with pytest.raises(BackendUnavailable, match="finds no nvcc"):
        select("cuda")
    present.add("gsplat.csrc")
    cuda_fault.cache_clear()
    assert select() == "cuda"
    cuda_fault.cache_clear()


def test_other_words_are_refused() -> None:
    with pytest.raises(ValueError, match="auto, cpu or cuda"):
        select("tpu")


@pytest.mark.parametrize(("name", "value"), CULLED)
def test_what_gsplat_cannot_draw_is_moved_out_of_sight(name: str, value: float) -> None:
    leaves = [torch.tensor(getattr(odd(name, value), n), requires_grad=True) for n in NAMES]
    pose, intrinsics, centre = (
        torch.tensor(array, dtype=torch.float32) for array in (CAMERA.world_to_camera, CAMERA.intrinsics, CAMERA.centre)
    )
    half = torch.tensor([CAMERA.width, CAMERA.height]) / 2
    found = sound(leaves, pose, intrinsics, centre, half)
    kept = slice(ODD.stop, None)
    weak = name == "opacities" and math.isfinite(value)  # gsplat itself leaves those out
    for old, new in zip(leaves, found, strict=True):
        assert torch.isfinite(new).all()
        assert torch.equal(new[kept], old[kept])
    assert (found[0][ODD] == centre).all(dim=1).all() != weak
    torch.stack([part.sum() for part in found]).sum().backward()
    for leaf in leaves:
        assert leaf.grad is not None
        assert (leaf.grad[kept] == 1).all()
        assert weak or not leaf.grad[ODD].any()


def test_what_lies_far_beside_the_picture_is_moved_out_of_sight() -> None:
    intrinsics, half = torch.tensor([[10.0, 0, 8], [0, 10, 6], [0, 0, 1]]), torch.tensor([8.0, 6.0])
    aside = torch.tensor([0.99, 1.01])  # picture sizes from the middle
    means = torch.cat(
        [
            torch.stack([aside * 1.6, 0 * aside, 1 + 0 * aside], 1),
            torch.stack([0 * aside, -aside * 1.2, 1 + 0 * aside], 1),
        ]
    )
    parts = [means, torch.ones(4, 4), 0.1 * torch.ones(4, 3), torch.ones(4), torch.ones(4, 3)]
    found = sound(parts, torch.eye(4), intrinsics, torch.tensor([7.0, 7.0, 7.0]), half)
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
    found = sound(parts, pose, torch.eye(3), torch.full((3,), 7.0), torch.ones(2))
    assert torch.equal((found[0] == 7).all(dim=1).long(), beyond)
    assert torch.equal(found[3].long(), 1 - beyond)


def test_strong_opacities_are_held_and_keep_their_gradient() -> None:
    opacities = torch.tensor([0.5, 2.0, 50.0], requires_grad=True)
    others = torch.ones(3, 3)
    parts = [others, torch.ones(3, 4), 0.1 * others, opacities, others]
    held = sound(parts, torch.eye(4), torch.eye(3), torch.zeros(3), torch.ones(2))[3]
    assert held.tolist() == [0.5, 2.0, 2.0]
    held.sum().backward()
    assert opacities.grad is not None
    assert opacities.grad.tolist() == [1, 1, 1]
