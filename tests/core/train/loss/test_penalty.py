"""What Gaussians cost whatever they show: their opacity and volume, and what that price removes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.frames import PointCloud
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.render.raster import Probe, Raster
from streamlod.core.scene.expand import expand
from streamlod.core.train import Trainer, preset
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.pictures.views import Views
from tests.core.train.keyframe.test_first_frame import frames, ring, short, wall

ALIKE = torch.ones(()), torch.zeros(())  # all pay the whole price, and none hides anything


def splats(opacities: torch.Tensor, scales: torch.Tensor) -> Splats:
    count = len(opacities)
    return Splats(torch.zeros(count, 3), torch.ones(count, 4), scales, opacities, torch.zeros(count, 3))


def seen(*rows: int) -> Raster:
    """A picture with the Gaussians `rows` in view."""
    return Raster(torch.zeros(2, 4, 3), torch.ones(2, 4), Probe(torch.tensor(rows)))


def test_gaussians_out_of_view_pay_nothing() -> None:
    config = KeyframeConfig(scale_weight=0.0, opacity_weight=0.4)
    loss = ViewLoss(Views(ring(3), torch.zeros(3, 32, 48, 3), [0, 1, 2]), neutral(3), config, "cpu")
    opacities = torch.full((5,), 0.5, requires_grad=True)
    loss.penalty(splats(opacities, torch.ones(5, 3)), seen(1, 3), *ALIKE).backward()  # type: ignore[no-untyped-call]
    price = 0.4 / 2 / 5
    torch.testing.assert_close(opacities.grad, torch.tensor([0.0, price, 0.0, price, 0.0]))


def test_what_hides_a_view_between_cameras_pays_in_every_step() -> None:
    config = KeyframeConfig(scale_weight=0.0, opacity_weight=0.4)
    loss = ViewLoss(Views(ring(3), torch.zeros(3, 32, 48, 3), [0, 1, 2]), neutral(3), config, "cpu")
    opacities = torch.tensor([0.5, 0.5, 0.5, -0.1], requires_grad=True)
    hiding = torch.tensor([0.0, 0.3, 0.3, 0.3])
    price = loss.penalty(splats(opacities, torch.ones(4, 3)), seen(0, 1), torch.full((4,), 0.5), hiding)
    price.backward()  # type: ignore[no-untyped-call]
    in_view = 0.5 * 0.4 / 2 / 4
    assert price.item() == pytest.approx(0.5 * (2 * in_view + 2 * 0.3))
    torch.testing.assert_close(opacities.grad, torch.tensor([in_view, in_view + 0.3, 0.3, 0.0]))


def test_each_shown_gaussian_pays_for_its_opacity_and_volume() -> None:
    opacities = torch.tensor([0.5, -0.2, 0.1, 0.9], requires_grad=True)
    scales = torch.tensor([[1.0, 2.0, 3.0], [9.0, 9.0, 9.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]], requires_grad=True)
    config = KeyframeConfig(scale_weight=0.1, opacity_weight=0.4)
    views = Views(ring(3), torch.zeros(3, 32, 48, 3), [0, 1, 2])
    all_seen = seen(0, 1, 2, 3)
    penalty = ViewLoss(views, neutral(3), config, "cpu").penalty(splats(opacities, scales), all_seen, *ALIKE)
    assert penalty.item() == pytest.approx(0.1 * (6 + 1 + 2) / 3 + 0.4 / 2 * (0.5 + 0.1 + 0.9) / 4)
    alone = ViewLoss(Views(ring(1), torch.zeros(1, 32, 48, 3), [0]), neutral(1), config, "cpu")
    assert alone.penalty(splats(opacities, scales), all_seen, *ALIKE).item() == pytest.approx(0.1 * 3 + 0.4 * 1.5 / 4)
    penalty.backward()  # type: ignore[no-untyped-call]
    torch.testing.assert_close(opacities.grad, torch.tensor([0.05, 0.0, 0.05, 0.05]))
    assert scales.grad is not None
    assert (scales.grad[1] == 0).all()


@pytest.mark.long
def test_gaussians_that_no_picture_needs_go() -> None:
    """A printed wall, and as many points again in layers just behind it, which the wall covers."""
    cameras, front = ring(4), wall(600)
    layers = [front.positions + np.array([0, 0, depth], np.float32) for depth in (0.0, 0.05, 0.1)]
    points = PointCloud(np.concatenate(layers), np.tile(front.colours, (3, 1)))
    print_ = np.random.default_rng(2).uniform(0.2, 0.8, (4, 4, 3)).repeat(8, 0).repeat(12, 1)
    pictures = np.tile(np.round(print_ * 255).astype(np.uint8), (4, 1, 1, 1))
    found = {}
    for weight in (0.0, 0.2):
        config = short(preset("live"), 100, max_anchors=4000)
        config = replace(config, keyframe=replace(config.keyframe, opacity_weight=weight))
        scene = Trainer(cameras, config, fps=10.0).keyframe(frames(pictures), points).scene
        cloud = expand(scene, cameras[1].centre)
        picture = render(cloud, cameras[1], scene.header.background).image
        drawn = np.clip(np.round(picture * 255), 0, 255).astype(np.uint8)
        found[weight] = cloud.opacities.sum(), psnr(drawn, pictures[1])
    assert found[0.2][0] < 0.8 * found[0.0][0]
    assert found[0.2][1] > 27.0  # what is seen stays


def test_a_dim_surface_is_opaque_and_black_may_be_nothing() -> None:
    """A wall, black on the left and dim on the right: over a background that is always black it need not be opaque."""
    cameras = ring(4)
    pictures = np.full((4, 32, 48, 3), 40, np.uint8)
    pictures[:, :, :24] = 0
    black, dim = {}, {}
    for random in (False, True):
        config = short(preset("live"), 100, max_anchors=4000)
        config = replace(config, keyframe=replace(config.keyframe, random_background=random))
        scene = Trainer(cameras, config, fps=10.0).keyframe(frames(pictures), wall(600)).scene
        cloud = expand(scene, cameras[1].centre)
        through = render(cloud, cameras[1], np.ones(3, np.float32)).transmittance
        black[random], dim[random] = through[8:24, 6:18].mean(), through[8:24, 30:42].mean()
    assert dim[False] > 0.2
    assert dim[True] < 0.05
    assert black[True] > 0.2
