"""Choosing a backend, and saying in one sentence why one is missing."""

import importlib.machinery
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from streamlod.core.errors import BackendUnavailable
from streamlod.core.render import select, warp
from streamlod.core.render.backends import cuda_fault, has_warp, warp_fault
from streamlod.core.train import preset
from streamlod.core.train.engine.named import named_engine
from streamlod.core.train.presets.settings import with_settings
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
    monkeypatch.setattr(warp, "finds_gpu", lambda: True)
    spec = importlib.machinery.ModuleSpec("warp", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec if name in ("torch", "warp") else None)
    assert select("cuda") == "warp"
    assert select() == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    cuda_fault.cache_clear()
    with pytest.raises(BackendUnavailable, match="no CUDA device"):
        select("cuda")


@pytest.mark.skipif(warp.finds_gpu(), reason="the driver is new enough here")
def test_a_driver_that_is_too_old_for_warp_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torch's wheels of CUDA 12 work with drivers that Warp's of CUDA 13 refuse."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    specs = {name: importlib.machinery.ModuleSpec(name, None) for name in ("torch", "warp")}
    monkeypatch.setattr(importlib.util, "find_spec", specs.get)
    assert not has_warp()
    with pytest.raises(BackendUnavailable, match="install gsplat"):
        select("cuda")
    config = with_settings(preset("live"), {"predict.engine": "warp"})
    with pytest.raises(BackendUnavailable, match=r"install a newer one, .* or set predict.engine=autograd"):
        named_engine(config, "cuda", "cuda")
    del specs["warp"]
    assert "install warp-lang" in str(warp_fault())


def test_a_folder_that_takes_no_kernels_of_warp_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    program = "import torch; torch.cuda.is_available = lambda: True; "
    program += "from streamlod.core.render.backends import warp_fault; print(warp_fault())"
    places = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "file")}
    done = subprocess.run([sys.executable, "-c", program], env=places, capture_output=True, text=True, check=True)
    assert "Not a directory" in done.stdout
    assert "XDG_CACHE_HOME" in done.stdout


def test_other_words_are_refused() -> None:
    with pytest.raises(ValueError, match="auto, cpu or cuda"):
        select("tpu")
