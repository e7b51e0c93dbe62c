"""Depths sought for single pixels: the kernel against plain code, and against the true depth of a clip."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.initialise.stereo.sweep import pair_geometry
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic
from streamlod.core.train.growth.depth_search import best_planes, inverse_depths, matched_pixels
from streamlod.core.train.kernels.windows import HALF, UNSEEN
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field

SPEC = SyntheticSpec(cameras=5, frames=1, width=128, height=72)


def sampled(picture: Float32, u: float, v: float) -> Float64:
    """[3] of `picture` at the pixel coordinates (u, v), bilinear, as though its edge went on for ever."""
    height, width = picture.shape[:2]
    u, v = min(max(u - 0.5, 0), width - 1), min(max(v - 0.5, 0), height - 1)
    x, y = int(u), int(v)
    share = {(0, 0): (1 - u + x) * (1 - v + y), (1, 0): (u - x) * (1 - v + y), (0, 1): (1 - u + x) * (v - y)}
    share[1, 1] = (u - x) * (v - y)
    total = np.zeros(3)
    for (dx, dy), weight in share.items():
        total += weight * picture[min(y + dy, height - 1), min(x + dx, width - 1)]
    return total


def plain_cost(
    picture: Float32, source: Float32, pair: tuple[Float64, Float64], inverse: float, at: tuple[int, int]
) -> float:
    """Of one pixel `at` (row, column) and one inverse depth."""
    row, column = at
    height, width = picture.shape[:2]
    rays, shift = pair
    own, other = [], []
    for dy, dx in product(range(-HALF, HALF + 1), repeat=2):
        own.append(picture[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1)].astype(float))
        u, v, w = rays @ [column + dx + 0.5, row + dy + 0.5, 1.0] + shift * inverse
        if dy == dx == 0 and not (w > 0 and 0 < u / w < width and 0 < v / w < height):
            return UNSEEN
        other.append(sampled(source, u / w, v / w))
    grey, warped = (np.mean(window, axis=1) for window in (own, other))
    covariance = np.mean(grey * warped) - grey.mean() * warped.mean()
    correlation = covariance / np.sqrt((grey.var() + 1e-4) * (warped.var() + 1e-4))
    return float(0.5 * (1 - correlation) + min(np.abs(np.array(own) - other).mean() / 0.1, 1.0))


def rig() -> tuple[tuple[Camera, ...], Float32]:
    clip = open_synthetic(SPEC)
    (frame,) = clip.frames()
    return clip.cameras, frame.images.astype(np.float32) / 255


@pytest.mark.long
def test_the_kernel_finds_what_plain_code_finds() -> None:
    cameras, pictures = rig()
    generator = np.random.default_rng(0)
    row, column = generator.integers(0, SPEC.height, 25), generator.integers(0, SPEC.width, 25)
    row[:2], column[:2] = (0, SPEC.height - 1), (0, SPEC.width - 1)
    inverse = np.linspace(0.12, 0.9, 12)
    others = [1, 2, 4]
    plane, cost = best_planes(
        pictures[0], pictures[others], cameras[0], [cameras[other] for other in others], inverse, row, column
    )
    pairs = [pair_geometry(cameras[0], cameras[other]) for other in others]
    for i, at in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        costs = []
        for depth in inverse:
            each = [plain_cost(pictures[0], pictures[o], p, depth, at) for o, p in zip(others, pairs, strict=True)]
            costs.append(sum(sorted(each)[:2]))
        assert cost[i] == pytest.approx(min(costs) / 2, abs=1e-4)
        assert costs[plane[i]] == pytest.approx(min(costs), abs=2e-4)


def test_pixels_with_texture_are_put_on_their_surface() -> None:
    cameras, pictures = rig()
    depth = ground_truth(SPEC, 0, 0).depth.astype(float)
    views = Views(cameras, torch.from_numpy(pictures), list(range(len(cameras))))
    grey = pictures[0].mean(axis=2)
    textured = np.abs(np.gradient(grey, axis=1)) + np.abs(np.gradient(grey, axis=0))
    row, column = np.unravel_index(np.argsort(-textured, axis=None)[:200], grey.shape)
    points = random_field(60)  # as deep as the room
    ends = torch.from_numpy(cameras[0].centre + np.outer(np.linspace(0.5, 9, 60), cameras[0].world_to_camera[2, :3]))
    found = matched_pixels(
        replace(points, position=ends.float()), views, 0, row.astype(np.int64), column.astype(np.int64)
    )
    seen = (found.position - cameras[0].centre) @ cameras[0].world_to_camera[2, :3]
    right = np.abs(seen / depth[found.row, found.column] - 1) < 0.05
    assert right.mean() > 0.7
    np.testing.assert_allclose(found.width, seen / cameras[0].intrinsics[0, 0])


def test_one_camera_alone_finds_nothing() -> None:
    cameras, pictures = rig()
    views = Views(cameras, torch.from_numpy(pictures), [2])
    found = matched_pixels(random_field(5), views, 2, np.arange(3), np.arange(3))
    assert len(found.row) == len(found.position) == 0


def test_depths_lie_a_pixel_of_parallax_apart() -> None:
    camera = rig()[0][0]
    axis = camera.world_to_camera[2, :3]
    position = torch.from_numpy(camera.centre + np.outer(np.linspace(1, 5, 40), axis)).float()
    living = replace(random_field(40), position=position)
    inverse = inverse_depths(living, camera, 0.5)
    assert inverse[0] < 1 / 4.9
    assert inverse[-1] > 1 / 1.1
    assert np.diff(inverse).max() * camera.intrinsics[0, 0] * 0.5 <= 1.0
