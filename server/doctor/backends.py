"""Rendering backends: gradients against the float64 reference, speed, and memory."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.server.doctor.finding import Finding, Verdict

if TYPE_CHECKING:
    from torch import Tensor

    from streamlod.core.render import Backend

MAX_ERROR = 2e-3  # relative, of a backend's gradients against float64
_CHECKED, _TIMED = 60, 20_000  # Gaussians
_ROUNDS = 3


def check_backends(device: str, quick: bool) -> Iterator[Finding]:
    """Findings on the backends: whether they are there, whether their gradients are right, how fast they are.

    Args:
        device: ``auto``, ``cpu`` or ``cuda``; a missing backend is a fault only where ``cuda`` was named.
        quick: leave out gradients and speed.
    """
    if importlib.util.find_spec("torch") is None:
        verdict = Verdict.FAULT if device == "cuda" else Verdict.ABSENT
        yield Finding("training", verdict, "torch is missing: only playback works", "pip install 'streamlod[train]'")
        return
    from streamlod.core.render.backends import cuda_fault, has_warp

    if not quick:
        yield _measured("cpu")
    fault = cuda_fault()
    if fault is not None:
        serious = Verdict.WARNING if has_warp() else _seriousness(device)  # it draws instead, if cuda is asked for
        yield Finding("backend cuda", serious, "does not work here", fault)
        if has_warp() and not quick:
            yield _measured("warp")
        return
    import torch

    free, total = (size / 2**30 for size in torch.cuda.mem_get_info())
    found = f"{torch.cuda.get_device_name()}, {free:.1f} of {total:.1f} GiB free, CUDA {torch.version.cuda}"
    yield Finding("device cuda", Verdict.OK, found)
    if not quick:
        yield _measured("cuda")
        if has_warp():
            yield _measured("warp")


def _seriousness(device: str) -> Verdict:
    """Verdict on a CUDA backend that does not work: a fault where it was asked for, a warning where a GPU lies idle."""
    from streamlod.core.render.backends import has_nvidia_device

    if device == "cuda":
        return Verdict.FAULT
    return Verdict.WARNING if device == "auto" and has_nvidia_device() else Verdict.ABSENT


def _measured(backend: Backend) -> Finding:
    check = f"backend {backend}"
    try:
        error = _gradient_error(backend)
        seconds, megabytes = _speed(backend)
    except Exception as fault:  # a driver or a compiler may raise anything; the report says what
        return Finding(check, Verdict.FAULT, f"{type(fault).__name__}: {fault}", "run it with --debug")
    found = f"gradient error {error:.1e}, {_TIMED // 1000}k Gaussians at 640x480 in {1e3 * seconds:.0f} ms"
    if megabytes:
        found += f", {megabytes:.0f} MiB of device memory"
    if not error <= MAX_ERROR:
        return Finding(
            check, Verdict.FAULT, found, f"gradients are wrong beyond {MAX_ERROR}: report it with this output"
        )
    return Finding(check, Verdict.OK, found)


def _gradient_error(backend: Backend) -> float:
    """Largest |g - g64| / |g64| over the five parameters of a small scene."""
    exact, found = _gradients("reference", _CHECKED, (48, 40)), _gradients(backend, _CHECKED, (48, 40))
    return max(float((f - e).norm() / e.norm()) for f, e in zip(found, exact, strict=True))


def _speed(backend: Backend) -> tuple[float, float]:
    """(seconds of one picture with gradients, peak MiB of device memory), after one that may compile kernels."""
    import torch

    _gradients(backend, _TIMED, (640, 480))
    if backend == "cuda":
        torch.cuda.reset_peak_memory_stats()
    begin = time.perf_counter()
    for _ in range(_ROUNDS):
        _gradients(backend, _TIMED, (640, 480))  # which waits for the device
    seconds = (time.perf_counter() - begin) / _ROUNDS
    return seconds, torch.cuda.max_memory_allocated() / 2**20 if backend == "cuda" else 0.0


def _gradients(backend: Backend, count: int, size: tuple[int, int]) -> list[Tensor]:
    """float64 gradients, on the host, of a random linear loss by means, quaternions, scales, opacities and colours."""
    import torch

    from streamlod.core.render import rasterise

    draw = np.random.default_rng(0)
    extent = 0.15 * (_CHECKED / count) ** (1 / 3)
    values = (
        draw.normal(0, 1.2, (count, 3)),
        draw.normal(size=(count, 4)),
        extent * np.exp(draw.normal(0, 0.6, (count, 3))),
        draw.uniform(0.1, 0.9, count),
        draw.uniform(0, 1, (count, 3)),
    )
    kind = torch.float64 if backend == "reference" else torch.float32
    place = "cuda" if backend in ("cuda", "warp") else "cpu"
    leaves = [torch.tensor(v.astype(np.float32), dtype=kind, device=place, requires_grad=True) for v in values]
    means, quaternions, scales, opacities, colours = leaves
    camera, background = _camera(*size), torch.zeros(3, dtype=kind, device=place)
    raster = rasterise(means, quaternions, scales, opacities, colours, camera, background, backend=backend)
    weights = torch.tensor(draw.normal(size=(camera.height, camera.width, 3)), dtype=kind, device=place)
    (raster.image * weights).sum().backward()  # type: ignore[no-untyped-call]
    return [leaf.grad.double().cpu() for leaf in leaves if leaf.grad is not None]


def _camera(width: int, height: int) -> Camera:
    pose = look_at(np.array([2.0, -1.5, -4.3]), np.zeros(3), np.array([0.1, -1.0, 0.0]))
    return pinhole("doctor", (0.9 * width, 0.9 * width), (width / 2, height / 2), (width, height), pose)
