"""Synchronised pictures and first points."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.frames import FrameSet, PointCloud


def test_a_frame_set_has_one_flag_a_camera() -> None:
    images = np.zeros((2, 4, 6, 3), np.uint8)
    assert FrameSet(0, 0, images, np.array([True, False])).present.sum() == 1
    with pytest.raises(ValueError, match="present must have shape 2"):
        FrameSet(0, 0, images, np.array([True]))
    with pytest.raises(TypeError, match="images must be an array of uint8"):
        FrameSet(0, 0, images.astype(np.float32), np.array([True, True]))
    with pytest.raises(ValueError, match="images must have shape NxNxNx3"):
        FrameSet(0, 0, images[..., :1], np.array([True, True]))


def test_a_point_cloud_has_one_colour_a_point() -> None:
    points = np.zeros((5, 3), np.float32)
    assert len(PointCloud(points, points)) == 5
    with pytest.raises(ValueError, match="colours must have shape 5x3, not 4x3"):
        PointCloud(points, points[:4])
    with pytest.raises(TypeError, match="positions must be an array of float32"):
        PointCloud(points.astype(np.float64), points)
