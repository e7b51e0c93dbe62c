"""Compile the kernels ahead of their first use."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.camera import pinhole
from streamlod.core.render.cpu.backdrop import forward_over, prepare
from streamlod.core.render.cpu.dirty_tiles import touched_tiles
from streamlod.core.render.cpu.frame import backward, forward
from streamlod.core.render.cpu.photometric import photometric_sums
from streamlod.core.render.cpu.workspace import Workspace
from streamlod.core.render.tiles import Box
from streamlod.core.scene.gaussians import GaussianCloud

_LOG = logging.getLogger(__name__)


def warm(tell: Callable[[str], None] | None = None) -> None:
    """Compile every kernel, or load it from the cache; about half a minute once, then under a second.

    Args:
        tell: called with one sentence before and after each group of kernels; the log by default.
    """
    tell = tell or _LOG.info
    workspace, background = Workspace(), np.zeros(3, np.float32)
    camera = pinhole("warm", (8.0, 8.0), (4.0, 4.0), (32, 8), np.eye(4))
    cloud = _one_gaussian()
    started = time.perf_counter()
    tell("compiling the rasteriser's forward kernels")
    frame = forward(workspace, cloud, camera, background)
    tell("compiling the rasteriser's backward kernels")
    backward(workspace, frame, cloud, np.ones_like(frame.image))
    tell("compiling the loss and what renders parts of a picture")
    photometric_sums(frame.image, frame.image, 0.2, (Box(0, 0, 8, 8),))
    touched = touched_tiles(camera, cloud, 1.0)  # one tile of two
    forward_over(workspace, cloud, prepare(cloud, camera, touched, touched, frame.image), background)
    tell(f"rasteriser ready after {time.perf_counter() - started:.1f} s")


def _one_gaussian() -> GaussianCloud:
    def row(*values: float) -> Float32:
        return np.array([values], np.float32)

    return GaussianCloud(row(0, 0, 1), row(1, 0, 0, 0), row(0.1, 0.1, 0.1), np.ones(1, np.float32), row(1, 1, 1))
