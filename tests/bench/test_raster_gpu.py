"""The benchmark of the rasteriser on a GPU, at a size that a CPU does at once, and without a GPU."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from core.render.backends import cuda_fault
from tests.bench.raster_gpu import gpu_report


def test_drawing_and_whole_pictures_are_reported() -> None:
    found = gpu_report("cpu", (200, 400), (150,), (64, 48), rounds=2, pictures=2)
    assert list(found) == ["200 Gaussians", "400 Gaussians", "150 anchors"]
    for case in ("200 Gaussians", "400 Gaussians"):
        assert found[case]["forward wall ms"] > 0
        assert found[case]["forward and backward wall ms"] > 0
    assert found["150 anchors"]["Gaussians"] == 1500
    assert found["150 anchors"]["pictures a second"] > 0


@pytest.mark.skipif(cuda_fault() is None, reason="the GPU works here")
def test_without_a_gpu_one_sentence_says_what_is_missing() -> None:
    command = [sys.executable, "-m", "tests.bench.raster_bench", "cuda"]
    answer = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert answer.returncode == 1
    assert answer.stdout == "cuda\n"
    assert answer.stderr.count("\n") == 1
    assert str(cuda_fault()) in answer.stderr
    assert torch.cuda.is_available() or "CUDA device" in answer.stderr
