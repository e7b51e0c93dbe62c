"""Where tests of the GPU path run: on a GPU where there is one, else on the pretend device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch

import streamlod.core.render.backends
import streamlod.core.render.cuda
from streamlod.core.render.backends import cuda_fault
from tests.device import pretend
from tests.device.rasterization import rasterization


@contextmanager
def on_gpu(patch: pytest.MonkeyPatch) -> Iterator[str]:
    """torch's name of the device; the cuda backend works on it inside."""
    if cuda_fault() is None:
        yield "cuda"
        return
    if not pretend.can_be_registered():
        pytest.skip(f"there is a GPU, but it cannot be used: {cuda_fault()}")
    name = pretend.register()
    for module in (streamlod.core.render.backends, streamlod.core.render.cuda):
        patch.setattr(module, "cuda_fault", lambda: None)
    patch.setattr(streamlod.core.render.backends, "GPU", name)
    patch.setattr(streamlod.core.render.cuda, "_gsplat", lambda: rasterization)
    patch.setattr(torch.Tensor, "pin_memory", lambda self: self)
    streamlod.core.render.cuda._device_camera.cache_clear()
    yield name
    streamlod.core.render.cuda._device_camera.cache_clear()


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """As `on_gpu`, for one test."""
    with on_gpu(monkeypatch) as name:
        yield name
