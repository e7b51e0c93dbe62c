"""The CPU kernels as a torch function."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.backdrop import Backdrop, Canvas, forward_over
from streamlod.core.render.cpu.frame import Frame, backward, forward
from streamlod.core.render.cpu.workspace import POOL, Workspace
from streamlod.core.render.raster import Probe, Raster
from streamlod.core.scene.gaussians import GaussianCloud


class _Call:
    """State of one rendering for forward and backward; its workspace goes back when either is done with it."""

    def __init__(self, camera: Camera, gradient_rows: int | None) -> None:
        self.camera = camera
        self.gradient_rows = gradient_rows
        self.workspace: Workspace = POOL.acquire()
        self.frame: Frame | None = None
        self.probe: Probe | None = None
        # Also when backward never runs: the graph dies, and this with it.
        self.release = weakref.finalize(self, POOL.release, self.workspace)
        self.release.atexit = False


class _Rasterise(torch.autograd.Function):
    """Gives out the picture that `call` already holds, and differentiates it."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quaternions: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colours: Tensor,
        call: _Call,
    ) -> tuple[Tensor, Tensor]:
        assert call.frame is not None
        ctx.call = call
        image, light = torch.from_numpy(call.frame.image), torch.from_numpy(call.frame.transmittance)
        # The frame reads the same memory as the outputs; saving them makes autograd notice if they change in place.
        ctx.save_for_backward(means, quaternions, scales, opacities, colours, image, light)
        ctx.set_materialize_grads(False)
        return image, light

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, image_gradient: Tensor | None, light_gradient: Tensor | None) -> tuple[Tensor | None, ...]:
        call: _Call = ctx.call
        frame = call.frame
        cloud = _cloud(*ctx.saved_tensors[:5])
        if frame is None or call.probe is None or not call.release.alive:
            raise RuntimeError("a rasterised picture can be differentiated once only; render it again")
        by_image = np.zeros_like(frame.image) if image_gradient is None else _array(image_gradient)
        by_light = None if light_gradient is None else _array(light_gradient)
        gradients = backward(call.workspace, frame, cloud, by_image, by_light, call.gradient_rows)
        half = np.array([call.camera.width / 2, call.camera.height / 2], np.float32)
        visible, screen = call.probe.visible.numpy(), gradients.screen * half
        if len(gradients.rows) < len(visible):  # some are in view, but not in the tiles of the mask
            everywhere = np.zeros((len(visible), 2), np.float32)
            everywhere[np.searchsorted(visible, gradients.rows)] = screen
            screen = everywhere
        call.probe.record(torch.from_numpy(screen))
        call.frame = None
        call.release()
        parts = (gradients.means, gradients.quaternions, gradients.scales, gradients.opacities, gradients.colours)
        return (*(torch.from_numpy(part) for part in parts), None)


def rasterise_cpu(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    camera: Camera,
    background: Tensor,
    gradient_rows: int | None,
    tile_mask: Tensor | None,
) -> Raster:
    """`core.render.differentiable.rasterise` on numba kernels; arguments as there."""
    call, parameters = _Call(camera, gradient_rows), (means, quaternions, scales, opacities, colours)
    mask = None if tile_mask is None else tile_mask.detach().cpu().numpy().astype(np.bool_)
    call.frame = forward(call.workspace, _cloud(*parameters), camera, _array(background), mask)
    return _raster(parameters, call)


def rasterise_over(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    backdrop: Backdrop,
    background: Tensor,
    canvas: Canvas,
    tiles: Bool | None = None,
) -> Raster:
    """Picture and gradients of these Gaussians before still ones: those of `rasterise` for both, in its tiles.

    The picture lies on the `canvas`; once another one is drawn there, it is gone and cannot be differentiated.

    Args:
        tiles: [tiles_y,tiles_x] bool, those to draw; all of the backdrop's by default.
    """
    call, parameters = _Call(backdrop.camera, None), (means, quaternions, scales, opacities, colours)
    call.frame = forward_over(call.workspace, _cloud(*parameters), backdrop, _array(background), canvas, tiles)
    return _raster(parameters, call)


def _raster(parameters: tuple[Tensor, ...], call: _Call) -> Raster:
    image, light = _Rasterise.apply(*parameters, call)  # type: ignore[no-untyped-call]
    assert call.frame is not None
    rows, most = call.frame.visible, call.gradient_rows
    visible = rows if most is None else rows[: np.searchsorted(rows, most)]
    call.probe = Probe(torch.from_numpy(visible.astype(np.int64)))
    return Raster(image, light, call.probe)


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()


def _cloud(*parameters: Tensor) -> GaussianCloud:
    return GaussianCloud(*(_array(parameter) for parameter in parameters))
