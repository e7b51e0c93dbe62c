"""Choosing a backend, and saying in one sentence why one is missing."""

import importlib.machinery
import importlib.util
import shutil

import pytest
import torch

from streamlod.core.errors import BackendUnavailable
from streamlod.core.render import select
from streamlod.core.render.backends import cuda_fault
from tests.core.render.scenes import make_camera, make_cloud, run


@pytest.fixture(autouse=True)
def _fresh() -> None:
    cuda_fault.cache_clear()


def test_cpu_is_always_there() -> None:
    assert select("cpu") == "cpu"


def test_auto_falls_back_to_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert select() == "cpu"
    with pytest.raises(BackendUnavailable, match=r"no CUDA device: .* or choose the device cpu$"):
        select("cuda")
    with pytest.raises(BackendUnavailable, match="no CUDA device"):
        run(make_cloud(3), make_camera(), "cuda")


def test_each_missing_part_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    present = {"torch"}
    spec = importlib.machinery.ModuleSpec("gsplat", None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec if name in present else None)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(BackendUnavailable, match="install gsplat"):
        select("cuda")
    present.add("gsplat")
    cuda_fault.cache_clear()
    with pytest.raises(BackendUnavailable, match="finds no nvcc"):
        select("cuda")
    present.add("gsplat.csrc")
    cuda_fault.cache_clear()
    assert select() == "cuda"
    cuda_fault.cache_clear()


def test_warp_draws_on_a_gpu_that_is_asked_for_and_lacks_gsplat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    spec = importlib.machinery.ModuleSpec("warp", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec if name in ("torch", "warp") else None)
    assert select("cuda") == "warp"
    assert select() == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    cuda_fault.cache_clear()
    with pytest.raises(BackendUnavailable, match="no CUDA device"):
        select("cuda")


def test_other_words_are_refused() -> None:
    with pytest.raises(ValueError, match="auto, cpu or cuda"):
        select("tpu")
