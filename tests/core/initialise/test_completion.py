"""Points in gaps: on the surface between those that are known, never before what another camera sees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.completion import completed, hides, nearest_depths, share_of_gaps, spread
from streamlod.core.initialise.views import WorkingViews, pixel_centres, unproject

UP = np.array([0.0, 0.0, 1.0])
WIDTH, HEIGHT = 64, 36


def camera_at(x: float, y: float = -2.0) -> Camera:
    """It looks along y."""
    eye = np.array([x, y, 0.0])
    size, middle = (WIDTH, HEIGHT), (WIDTH / 2, HEIGHT / 2)
    return pinhole(f"{x}", (40, 40), middle, size, look_at(eye, eye + np.array([0.0, 1.0, 0.0]), UP))


def views_of(*cameras: Camera, image: Float32 | None = None) -> WorkingViews:
    plain = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32) if image is None else image
    return WorkingViews(cameras, np.stack([plain] * len(cameras)))


def slope(camera: Camera) -> np.ndarray:
    """[H,W] inverse depth of a plane that a camera sees at a slant."""
    column, row = pixel_centres(camera).T
    return np.asarray((0.3 + 0.002 * column + 0.001 * row).reshape(HEIGHT, WIDTH))


def test_between_known_pixels_of_a_plane_lies_the_plane() -> None:
    inverse = slope(camera_at(0))
    known = np.zeros((HEIGHT, WIDTH), bool)
    known[:, :3] = known[:, -3:] = known[:3] = known[-3:] = True
    found = spread(np.where(known, 1 / inverse, np.inf), views_of(camera_at(0)).images[0])
    np.testing.assert_allclose(found, inverse, rtol=1e-3)


def test_depths_stop_at_edges_of_the_picture() -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    image[:, 40:] = 1.0
    depths = np.full((HEIGHT, WIDTH), np.inf)
    depths[:, 0], depths[:, -1] = 2.0, 8.0
    found = 1 / spread(depths, image)
    assert found[:, :40].max() < 2.8
    assert found[:, 40:].min() > 4.8  # a plain surface of one colour would have crossed 4 in mid-picture
    assert found.min() >= 2.0 - 1e-2
    assert found.max() <= 8.0 + 1e-2


def test_every_cell_of_every_view_has_a_point_afterwards_and_its_colour() -> None:
    image = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32)
    cameras = camera_at(-1.0), camera_at(1.0)
    first = unproject(cameras[0], np.array([[10.5, 10.5], [50.5, 20.5]]), np.array([3.0, 4.0])).astype(np.float32)
    points = PointCloud(first, np.ones((2, 3), np.float32))
    found = completed(points, views_of(*cameras, image=image))
    np.testing.assert_array_equal(found.positions[:2], first)
    for camera in cameras:
        shown = np.isfinite(nearest_depths(found.positions, camera))
        assert maximum_filter(shown, 3).all()
    pixel = np.array([20.5, 30.5])
    at = unproject(cameras[0], pixel[None], np.ones(1)) - cameras[0].centre
    away = found.positions[2:] - cameras[0].centre
    there = np.argmax(away @ at[0] / np.linalg.norm(away, axis=1))
    np.testing.assert_allclose(found.colours[2 + there], image[30, 20], atol=1e-5)


def test_no_point_hides_what_another_view_is_known_to_see() -> None:
    cameras = camera_at(-1.0), camera_at(1.0)
    grid = pixel_centres(cameras[1])
    wall = unproject(cameras[1], grid, np.full(len(grid), 6.0))
    near = unproject(cameras[0], np.array([[2.5, 2.5], [2.5, 30.5]]), np.array([1.0, 1.0]))
    points = PointCloud(np.concatenate([wall, near]).astype(np.float32), np.ones((len(wall) + 2, 3), np.float32))
    new = completed(points, views_of(*cameras)).positions[len(points) :]
    assert len(new) > 0  # camera 0 sees past the wall's end
    assert not hides(new, cameras[1], nearest_depths(points.positions, cameras[1])).any()


def test_a_camera_alone_gets_points_in_all_its_gaps() -> None:
    camera = camera_at(0)
    known = unproject(camera, np.array([[10.5, 10.5]]), np.array([3.0])).astype(np.float32)
    found = completed(PointCloud(known, np.ones((1, 3), np.float32)), views_of(camera))
    assert found.positions.shape == found.colours.shape == (1 + WIDTH * HEIGHT - 9, 3)


def test_a_view_of_nothing_known_stays_empty() -> None:
    behind = PointCloud(np.array([[0.0, -9.0, 0.0]], np.float32), np.ones((1, 3), np.float32))
    assert len(completed(behind, views_of(camera_at(0)))) == 1


def test_alone_fills_what_no_other_camera_looks_at() -> None:
    cameras = camera_at(-3.0), camera_at(3.0)
    grid = pixel_centres(cameras[0])
    wall = unproject(cameras[0], grid[::7], np.full(len(grid[::7]), 6.0)).astype(np.float32)
    points = PointCloud(wall, np.ones((len(wall), 3), np.float32))
    views = views_of(*cameras)
    all_gaps, own = (completed(points, views, alone=alone).positions[len(wall) :] for alone in (False, True))
    assert 0 < len(own) < len(all_gaps)
    both = [np.isfinite(nearest_depths(own, camera)) for camera in cameras]
    assert sum(seen.sum() for seen in both) <= len(own), "each is seen by one camera only"


def test_gaps_are_counted_where_they_are_fewest() -> None:
    cameras = camera_at(-9.0), camera_at(9.0)
    grid = pixel_centres(cameras[0])
    half = grid[grid[:, 0] < WIDTH / 2]
    points = [
        unproject(camera, some, np.full(len(some), 2.0))
        for camera, some in zip(cameras, (half, grid[::99]), strict=True)
    ]
    cloud = PointCloud(np.concatenate(points).astype(np.float32), np.ones((len(half) + len(grid[::99]), 3), np.float32))
    assert share_of_gaps(cloud, views_of(*cameras)) == pytest.approx(0.5, abs=0.05)
    assert share_of_gaps(cloud, views_of(cameras[1])) > 0.7
    assert share_of_gaps(cloud, views_of(camera_at(99.0))) == 1
