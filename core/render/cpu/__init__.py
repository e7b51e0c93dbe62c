"""Gaussian splatting on the CPU: numpy and numba, no torch.

Pictures do not depend on the number of threads, gradients do; several threads may render at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, check_array
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.frame import contiguous, forward
from streamlod.core.render.cpu.listing import MAX_PAIRS
from streamlod.core.render.cpu.workspace import POOL
from streamlod.core.scene.gaussians import GaussianCloud

__all__ = ["Rendered", "render"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """A picture: image [H,W,3] float32 RGB, over the background; transmittance [H,W] float32 in [0, 1]."""

    image: Float32
    transmittance: Float32


def render(cloud: GaussianCloud, camera: Camera, background: Float32, most_pairs: int = MAX_PAIRS) -> Rendered:
    """Splat `cloud` as `camera` sees it.

    Gaussians with numbers that are not finite, or that overflow when projected, are left out.

    Args:
        background: [3] float32 RGB behind everything.
        most_pairs: of a Gaussian and a tile; bounds time and memory.

    Raises:
        InputError: the camera has lens distortion.
        ModelError: the Gaussians together cover more tiles than `most_pairs`.
    """
    check_array("background", background, (3,), np.float32)
    workspace = POOL.acquire()
    frame = forward(workspace, contiguous(cloud), camera, background, most_pairs=most_pairs)
    POOL.release(workspace)
    return Rendered(frame.image, frame.transmittance)
