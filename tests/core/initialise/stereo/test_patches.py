"""Slanted windows: their cost against a slow reference, and surfaces that windows facing the camera cannot measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.initialise.stereo import patch_kernel
from streamlod.core.initialise.stereo.patch_kernel import (
    COLOUR_CLAMP,
    COLOUR_SCALE,
    FLAT,
    LONE,
    RADIUS,
    SAMPLES,
    STRIDE,
    UNSEEN,
    Pairs,
)
from streamlod.core.initialise.stereo.patches import slanted
from streamlod.core.initialise.stereo.sweep import pair_geometry, sweep_views
from streamlod.core.initialise.views import WorkingViews, pixel_centres, unproject

WIDTH, HEIGHT = 64, 48
BOUNDS = (0.8, 8.0)
UP = np.array([0.0, 0.0, 1.0])


def camera(x: float) -> Camera:
    """Above the floor, looking down at it along y: the floor is seen at 10 to 50 degrees."""
    eye = np.array([x, 0.0, 0.9])
    pose = look_at(eye, np.array([0.0, 1.5, 0.0]), UP)
    return pinhole(f"{x}", (60, 60), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), pose)


CAMERAS = (camera(-0.5), camera(0.0), camera(0.5))


def floor_depth(of: Camera) -> Float64:
    """[H,W] depth of the floor z = 0."""
    origin = of.centre
    direction = unproject(of, pixel_centres(of), np.ones(WIDTH * HEIGHT)) - origin
    return (-origin[2] / direction[:, 2]).reshape(HEIGHT, WIDTH)


def floor_picture(of: Camera, amplitude: float = 0.5) -> Float32:
    """[H,W,3] the floor with a texture that has no two equal places."""
    x, y, _ = unproject(of, pixel_centres(of), floor_depth(of).ravel()).T
    waves = [np.sin(7 * x + 3 * y) * np.sin(5 * y - 2 * x), np.sin(9 * x - 4 * y), np.sin(6 * y + x * x + y * y)]
    return np.asarray(0.5 + 0.5 * amplitude * np.stack(waves, axis=1).reshape(HEIGHT, WIDTH, 3), np.float32)


def views(amplitude: float = 0.5) -> WorkingViews:
    return WorkingViews(CAMERAS, np.stack([floor_picture(one, amplitude) for one in CAMERAS]))


def reference_cost(reference: Float32, source: Float32, rays: Float64, shift: Float64, pixel: tuple[int, int],
                   plane: Float64) -> float:  # fmt: skip
    """The cost of one plane against one source, as the module's text says it."""
    x, y = pixel
    mine, theirs, weights = list[Float64](), list[Float64](), list[float]()
    offsets = range(-RADIUS, RADIUS + 1, STRIDE)
    total = 0.0
    for dy, dx in ((dy, dx) for dy in offsets for dx in offsets):
        if not (0 <= x + dx < WIDTH and 0 <= y + dy < HEIGHT):
            continue
        weight = np.exp(-np.abs(reference[y + dy, x + dx] - reference[y, x]).sum() / (3 * COLOUR_SCALE))
        total += weight
        u, v, w = rays @ [x + dx + 0.5, y + dy + 0.5, 1] + shift * (plane @ [1, dx, dy])
        u, v = u / w, v / w
        if not (0 < u < WIDTH and 0 < v < HEIGHT):
            continue
        u, v = np.clip(u - 0.5, 0, WIDTH - 1.001), np.clip(v - 0.5, 0, HEIGHT - 1.001)
        (x0, fu), (y0, fv) = divmod(u, 1), divmod(v, 1)
        corners = source[int(y0) : int(y0) + 2, int(x0) : int(x0) + 2].astype(np.float64)
        theirs.append(np.einsum("ijc,i,j->c", corners, [1 - fv, fv], [1 - fu, fu]))
        mine.append(reference[y + dy, x + dx].astype(np.float64))
        weights.append(float(weight))
    a, b, share = np.array(mine), np.array(theirs), np.array(weights) / np.sum(weights)
    grey_a, grey_b = a.mean(axis=1), b.mean(axis=1)
    off_a, off_b = grey_a - share @ grey_a, grey_b - share @ grey_b
    correlation = share @ (off_a * off_b) / np.sqrt((share @ off_a**2 + FLAT) * (share @ off_b**2 + FLAT))
    return float(0.5 * (1 - correlation) + min(share @ np.abs(a - b).mean(axis=1) / COLOUR_CLAMP, 1))


def pairs_of(all_views: WorkingViews, index: int, sources: list[int], held: float) -> Pairs:
    there = [pair_geometry(CAMERAS[index], CAMERAS[source]) for source in sources]
    back = [pair_geometry(CAMERAS[source], CAMERAS[index]) for source in sources]
    weights = np.empty((HEIGHT, WIDTH, SAMPLES), np.float32)
    patch_kernel.window_weights(all_views.images[index], weights)
    return Pairs(
        all_views.images[index], weights, all_views.images[sources],
        np.stack([rays for rays, _ in there]), np.stack([shift for _, shift in there]),
        np.stack([rays for rays, _ in back]), np.stack([shift for _, shift in back]),
        np.full((len(sources), HEIGHT, WIDTH), held),
    )  # fmt: skip


def test_costs_are_those_of_the_reference() -> None:
    generator = np.random.default_rng(3)
    images = generator.random((3, HEIGHT, WIDTH, 3)).astype(np.float32) * 0.3
    pairs = pairs_of(WorkingViews(CAMERAS, images), 1, [2], 0.3)
    planes = np.stack(
        [generator.uniform(0.2, 0.5, (HEIGHT, WIDTH)), *generator.uniform(-0.004, 0.004, (2, HEIGHT, WIDTH))], axis=2
    )
    cost = np.empty((HEIGHT, WIDTH), np.float32)
    patch_kernel.plane_costs(pairs, 0.0, planes, cost)
    compared = 0
    for y, x in generator.integers((HEIGHT, WIDTH), size=(200, 2)):
        if cost[y, x] >= UNSEEN - 1e-3:
            continue
        expected = reference_cost(images[1], images[2], pairs.rays[0], pairs.shifts[0], (x, y), planes[y, x])
        assert cost[y, x] == pytest.approx(min(expected + LONE, UNSEEN), abs=2e-3)
        compared += 1
    assert compared > 50


def test_surfaces_are_looked_up_within_the_source() -> None:
    """A pixel that is seen on a source's lower edge lies on one side of it in float32, and on the other in float64."""
    generator = np.random.default_rng(4)
    grey = WorkingViews(CAMERAS, np.full((3, HEIGHT, WIDTH, 3), 0.5, np.float32))
    held = np.zeros((2, HEIGHT, WIDTH))  # the second one lies behind the source's in memory, and is none of its own
    usual = pairs_of(grey, 1, [2], 0.0)._replace(rays=np.eye(3)[None], back_rays=np.eye(3)[None], inverse=held[:1])
    x, y, costs = 0, 10, np.empty((2, 300), np.float32)
    for trial in range(300):
        down, away = 40.0, generator.uniform(0.1, 0.5)
        beyond = HEIGHT * (1 + generator.uniform(0, 1e-8))
        planes = np.zeros((HEIGHT, WIDTH, 3))
        planes[y, x, 0] = (beyond - (y + 0.5)) / (down - beyond * away)
        pairs = usual._replace(shifts=np.array([[0.0, down, away]]), back_shifts=np.array([[0.0, -1.0, 0.0]]))
        for row, surface in enumerate((0.0, HEIGHT - (y + 0.5))):
            held[1], cost = surface, np.empty((HEIGHT, WIDTH), np.float32)
            patch_kernel.plane_costs(pairs, 0.3, planes, cost)
            costs[row, trial] = cost[y, x]
    assert (costs[0] < UNSEEN).sum() > 30
    np.testing.assert_array_equal(*costs)


def test_a_floor_seen_at_a_slant_is_measured() -> None:
    """Windows that face the cameras find less than half of it."""
    facing = sweep_views(views(), BOUNDS, 96)
    maps = slanted(views(), facing, BOUNDS)
    right = [
        np.mean([np.mean(np.abs(one.depth / floor_depth(one.camera) - 1)[4:-4, 14:-14] < 0.01) for one in found])
        for found in (facing, maps)
    ]
    assert right[1] > 0.85
    assert right[1] > right[0] + 0.2


def test_normals_are_those_of_the_surface() -> None:
    maps = slanted(views(), sweep_views(views(), BOUNDS, 96), BOUNDS)
    for one in maps:
        away = one.normals().reshape(HEIGHT, WIDTH, 3)[4:-4, 14:-14]
        np.testing.assert_allclose(np.linalg.norm(away, axis=-1), 1.0)
        assert np.median(away @ -UP) > 0.99  # the floor's, seen from above


@pytest.mark.long
def test_equal_inputs_give_equal_depths() -> None:
    facing = sweep_views(views(), BOUNDS, 32)
    first, second = (slanted(views(), facing, BOUNDS) for _ in range(2))
    assert all((one.depth == other.depth).all() for one, other in zip(first, second, strict=True))


def test_depths_of_what_has_no_texture_are_ambiguous() -> None:
    plain = views(amplitude=0.0)
    maps = slanted(plain, sweep_views(plain, BOUNDS, 32), BOUNDS)
    assert all((one.margin < 0.02)[8:-8, 16:-16].all() for one in maps)
    assert all((one.certain(0.02).cost == UNSEEN)[8:-8, 16:-16].all() for one in maps)


def test_cameras_in_one_place_measure_no_depth() -> None:
    """Without parallax every depth matches equally well."""
    textured = floor_picture(CAMERAS[1])
    turned = replace(
        CAMERAS[1], name="turned", world_to_camera=look_at(CAMERAS[1].centre, np.array([0.2, 1.5, 0.0]), UP)
    )
    for second, picture in ((CAMERAS[1], textured), (turned, floor_picture(turned))):
        together = WorkingViews((CAMERAS[1], second), np.stack([textured, picture]))
        maps = slanted(together, sweep_views(together, BOUNDS, 32), BOUNDS)
        assert all((one.certain(-1.0).cost == UNSEEN).all() for one in maps)
