"""The rasteriser on a GPU: ``raster_bench cuda``. The device is an argument, so that this is tested without a GPU."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch

from streamlod.core.render import Backend, rasterise, select
from streamlod.core.train.field.convert import field_of
from tests.bench.frame_subjects import draw_pictures, make_state
from tests.bench.raster_subjects import make_scene, tensors

_ROUNDS, _PICTURES = 20, 200


def gpu_report(
    device: str,
    counts: tuple[int, ...],
    anchors: tuple[int, ...],
    size: tuple[int, int],
    rounds: int = _ROUNDS,
    pictures: int = _PICTURES,
) -> dict[str, Any]:
    """Wall time on `device` of drawing `counts` Gaussians, with gradients and without, and pictures a second of scenes
    of `anchors`, of which every picture chooses its levels and decodes them."""
    backend = select(device)
    found: dict[str, Any] = {f"{count} Gaussians": step_times(device, backend, count, size, rounds) for count in counts}
    return found | {f"{count} anchors": _pictures(device, count, size, pictures) for count in anchors}


def step_times(
    device: str, backend: Backend, count: int, size: tuple[int, int], rounds: int = _ROUNDS
) -> dict[str, float]:
    """Milliseconds of drawing `count` Gaussians with `backend`, without gradients and with them."""
    cloud, camera = make_scene(count, *size)
    leaves = [value.detach().to(device).requires_grad_() for value in tensors(cloud)]
    background = torch.zeros(3, device=device)

    def draw() -> torch.Tensor:
        return rasterise(*leaves, camera=camera, background=background, backend=backend).image

    def forward() -> None:
        with torch.no_grad():
            draw()

    def both() -> None:
        torch.autograd.grad(draw().square().mean(), leaves)

    subjects = {"forward": forward, "forward and backward": both}
    return {f"{name} wall ms": 1e3 * min(_seconds(work, device, rounds)) for name, work in subjects.items()}


def _pictures(device: str, anchors: int, size: tuple[int, int], pictures: int) -> dict[str, float]:
    cameras, scene = make_state(anchors, 5, size)
    field = field_of(scene).to(device)
    taken = _seconds(lambda: draw_pictures(field, cameras, device, pictures), device, 1)[0]
    return {"pictures a second": pictures / taken, "Gaussians": float(anchors * field.slots)}


def _seconds(work: Callable[[], None], device: str, rounds: int) -> list[float]:
    """Wall seconds of each round; the device is idle at both ends."""
    work()  # kernels load, memory is reserved
    times = list[float]()
    for _ in range(rounds):
        finish(device)
        begin = time.perf_counter()
        work()
        finish(device)
        times.append(time.perf_counter() - begin)
    return times


def finish(device: str) -> None:
    """Wait until the device has done what it was told."""
    if device == "cuda":
        torch.cuda.synchronize()
