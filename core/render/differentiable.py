"""The training interface: splatting as a differentiable function of torch tensors, over any backend."""

from __future__ import annotations

from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.render.backends import Backend
from streamlod.core.render.raster import Raster
from streamlod.core.render.tiles import tile_grid


def rasterise(
    means: Tensor,  # [N,3]
    quaternions: Tensor,  # [N,4]
    scales: Tensor,  # [N,3]
    opacities: Tensor,  # [N]
    colours: Tensor,  # [N,3]
    camera: Camera,
    background: Tensor,  # [3]
    *,
    gradient_rows: int | None = None,
    tile_mask: Tensor | None = None,  # [tiles_y,tiles_x]
    backend: Backend = "cpu",
) -> Raster:
    """Splat Gaussians (Kerbl et al. 2023, equation 3) as `camera` sees them.

    Differentiable by the five parameters, once; not by the camera or the background.

    Args:
        means, quaternions (w x y z, any length), scales, opacities, colours: float32 on one device, all activated.
        background: [3] float32 RGB.
        gradient_rows: only the first rows get gradients, the others stand still; all by default.
        tile_mask: bool, tiles of `core.render.tiles` that the loss looks at; all by default. The CPU does not draw the
            others, which stay black.
        backend: as `core.render.select` says.

    Raises:
        InputError: the camera has lens distortion.
        ModelError: the Gaussians are so large that the CPU backend's lists would not fit.
        ValueError: shapes do not fit each other.
    """
    count = len(means)
    wanted = ((count, 3), (count, 4), (count, 3), (count,), (count, 3), (3,))
    given = (means, quaternions, scales, opacities, colours, background)
    for name, tensor, shape in zip(_NAMES, given, wanted, strict=True):
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} must have shape {shape}, not {tuple(tensor.shape)}")
    if tile_mask is not None and tuple(tile_mask.shape) != tile_grid(camera.width, camera.height):
        raise ValueError(f"tile_mask must have shape {tile_grid(camera.width, camera.height)}")
    if camera.has_distortion:
        raise InputError(f"camera {camera.name}", "has lens distortion; undistort its pictures and use undistorted()")
    if gradient_rows is not None:
        gradient_rows = min(max(gradient_rows, 0), count)
    arguments = (means, quaternions, scales, opacities, colours, camera, background, gradient_rows)
    # Imported when used: numba takes 0.3 s, gsplat and Warp may compile for minutes.
    if backend == "cpu":
        from streamlod.core.render.cpu.autograd import rasterise_cpu

        return rasterise_cpu(*arguments, tile_mask)
    if backend == "cuda":
        from streamlod.core.render.cuda import rasterise_cuda

        return rasterise_cuda(*arguments)
    if backend == "warp":
        from streamlod.core.render.warp.rasterise import rasterise_warp

        return rasterise_warp(*arguments)
    from streamlod.core.render.reference import rasterise_reference

    return rasterise_reference(*arguments)


_NAMES = ("means", "quaternions", "scales", "opacities", "colours", "background")
