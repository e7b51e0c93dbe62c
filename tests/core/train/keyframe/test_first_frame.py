"""The first frame: sizes of pictures, levels that are kept, and rigs at the edge of what can be done."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.render.raster import Raster
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.pictures.views import Views

UP = np.array([0.0, -1.0, 0.0])


def ring(count: int, width: int = 48, height: int = 32) -> tuple[Camera, ...]:
    """Cameras side by side that look at the origin from four units away."""
    eyes = [np.array([x, 0.1 * x, -4.0]) for x in np.linspace(-0.6, 0.6, count)]
    centre = (width / 2, height / 2)
    return tuple(
        pinhole(f"cam{i:02}", (40, 40), centre, (width, height), look_at(eye, np.zeros(3), UP))
        for i, eye in enumerate(eyes)
    )


def frames(pictures: np.ndarray) -> FrameSet:
    return FrameSet(0, 0, pictures, np.ones(len(pictures), np.bool_))


def wall(points: int, seed: int = 0) -> PointCloud:
    """Grey points on the plane z = 0."""
    generator = np.random.default_rng(seed)
    positions = np.zeros((points, 3), np.float32)
    positions[:, :2] = generator.uniform(-1.5, 1.5, (points, 2))
    return PointCloud(positions, np.full((points, 3), 0.5, np.float32))


def short(config: TrainConfig, steps: int, **model: object) -> TrainConfig:
    keyframe = replace(config.keyframe, steps=steps, growth_interval=max(steps // 20, 1))
    return replace(config, keyframe=keyframe, model=replace(config.model, **model))  # type: ignore[arg-type]


def values(scene: Scene) -> list[np.ndarray]:
    cloud = expand(scene, np.array([0.0, 0.0, -4.0]))
    return [cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours]


def test_halved_pictures_show_the_same_scene() -> None:
    cameras = ring(2, 49, 33)  # odd sizes: the last row and column are shared out
    pictures = torch.rand(2, 33, 49, 3)
    halved = Views(cameras, pictures, [1]).halved()
    assert halved.targets.shape == (2, 16, 24, 3)
    assert halved.usable == [1]
    torch.testing.assert_close(halved.targets.mean(dim=(1, 2)), pictures.mean(dim=(1, 2)), atol=0.02, rtol=0)
    point = np.array([0.2, 0.3, 0.1, 1.0])
    for whole, half in zip(cameras, halved.cameras, strict=True):
        seen = [camera.intrinsics @ (camera.world_to_camera @ point)[:3] for camera in (whole, half)]
        relative = [s[:2] / s[2] / (c.width, c.height) for s, c in zip(seen, (whole, half), strict=True)]
        np.testing.assert_allclose(*relative)


@pytest.mark.parametrize(
    ("rows", "sizes"),
    [(1, [1]), (159, [159]), (160, [80, 160]), (319, [159, 319]), (360, [90, 180, 360]), (720, [90, 180, 360, 720])],
)
def test_pictures_become_small_where_they_are_large(rows: int, sizes: list[int]) -> None:
    views = Views(ring(2, 8, rows), torch.rand(2, rows, 8, 3), [0, 1])
    assert [one.targets.shape[1] for one in views.sizes()] == sizes
    assert views.sizes()[-1] is views


def test_a_first_frame_goes_from_small_pictures_to_the_whole_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, draw = list[int](), ViewLoss.draw

    def noting(self: ViewLoss, splats: Splats, number: int) -> Raster:
        drawn.append(self.views.targets.shape[1])
        return draw(self, splats, number)

    config, cameras = short(preset("live"), 10), ring(2, 32, 640)
    config = replace(config, keyframe=replace(config.keyframe, rounding_from=1.0, growth_until=0.0))
    pictures = np.full((2, 640, 32, 3), 99, np.uint8)
    monkeypatch.setattr(ViewLoss, "draw", noting)
    Trainer(cameras, config, 30.0, "cpu").keyframe(frames(pictures), wall(60))
    assert drawn[:10] == [80, 80, 160, 320] + [640] * 6


def printed_wall(cameras: tuple[Camera, ...], period: float) -> np.ndarray:
    """Pictures [C,H,W,3] uint8 of a checked plane z = 0."""
    pictures = []
    for camera in cameras:
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.intrinsics).T
        rays = rays @ camera.world_to_camera[:3, :3]
        hit = camera.centre + rays * (-camera.centre[2] / rays[..., 2])[..., None]
        check = (np.floor(hit[..., :2] / period).sum(axis=-1) % 2)[..., None]
        pictures.append(np.broadcast_to(40 + 170 * check, (*check.shape[:2], 3)))
    return np.stack(pictures).astype(np.uint8)


@pytest.mark.long
def test_a_plain_wall_keeps_fewer_anchors_than_a_printed_one() -> None:
    """Nothing makes anchors grow on it, and those of little effect go."""
    cameras, config = ring(3), short(preset("live"), 200, finer_levels=3, cell_pixels=16.0)
    kept = []
    for pictures in (np.full((3, 32, 48, 3), 128, np.uint8), printed_wall(cameras, 0.3)):
        scene = Trainer(cameras, config, 30.0, "cpu").keyframe(frames(pictures), wall(600)).scene
        kept.append(sum(len(level) for level in scene.levels))
    assert 2 * kept[0] < kept[1]


@pytest.mark.parametrize("name", ["live", "paper"])
def test_two_views_and_fifty_points_train(name: str) -> None:
    cameras = ring(2)
    steep = np.linspace(20, 230, 48).astype(np.uint8)
    pictures = np.broadcast_to(steep[None, None, :, None], (2, 32, 48, 3)).copy()
    trained = Trainer(cameras, short(preset(name), 60), 30.0, "cpu").keyframe(frames(pictures), wall(50))
    assert trained.report.repaired == 0
    assert np.isfinite(trained.report.loss)
    assert all(np.isfinite(part).all() for part in values(trained.scene))
    shown = render(expand(trained.scene, cameras[0].centre), cameras[0], np.zeros(3, np.float32)).image
    assert psnr(shown.clip(0, 1), pictures[0].astype(np.float32) / 255) > 14
