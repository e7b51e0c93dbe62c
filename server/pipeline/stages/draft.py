"""A first picture within seconds: a small scene, trained for a moment on small pictures of a coarse sweep's points.

It shows the right colours in the right places while first points are measured and the first frame is trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise.coarse import coarse_sweep
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.views import working_views
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import TrainConfig, Trainer

_ROWS = 120  # of the pictures
_STEPS = 60
_MAX_ANCHORS = 8000
_CELL_PIXELS = 4.0  # of the coarsest of few levels, so that the first of them is a picture already


def draft_scene(
    frame: FrameSet,
    cameras: Sequence[Camera],
    config: TrainConfig,
    fps: float,
    device: str,
    rig: tuple[Camera, ...] | None = None,
    depth_bounds: tuple[float, float] | None = None,
    dataset_points: PointCloud | None = None,
) -> Scene:
    """A keyframe of the instant `frame`, to be shown until there is a better one.

    Args:
        cameras: [C] pinholes of the pictures. rig: as viewers are told them; `cameras` by default.
        config: of the stream; steps, sizes and growth are a draft's own.
        device, depth_bounds, dataset_points: as of `Trainer` and `first_points`.

    Raises:
        InputError: fewer than two cameras are present, or they cannot measure depth.
        ModelError: no surface was found at all.
    """
    points = coarse_sweep(PointSources(frame, cameras, depth_bounds, dataset_points, config.seed, lambda _: None))
    small = working_views(frame, cameras, _ROWS)
    images = np.zeros((len(cameras), *small.images.shape[1:]), np.uint8)
    images[frame.present] = (255 * small.images).round()
    pictures = replace(frame, images=images)
    most = min(_MAX_ANCHORS, config.model.max_anchors)
    keyframe = replace(config.keyframe, steps=_STEPS, growth_from=1.0, progressive_until=0.0)
    config = replace(
        config,
        model=replace(config.model, max_anchors=most, cell_pixels=_CELL_PIXELS, finer_levels=1, first_cell_pixels=0.0),
        keyframe=keyframe,
    )
    shrunk = tuple(camera.scaled(*small.size) for camera in cameras)
    return Trainer(shrunk, config, fps, device, rig or tuple(cameras)).keyframe(pictures, points).scene
