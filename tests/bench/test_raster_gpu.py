"""The benchmark of the rasteriser on a GPU, at a size that a CPU does at once, and without a GPU."""

from __future__ import annotations

import sys

import numba
import pytest
import torch

from streamlod.core.render.backends import cuda_fault
from tests.bench import raster_bench
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
def test_without_a_gpu_one_sentence_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["raster_bench", "cuda"])
    threads = numba.get_num_threads(), torch.get_num_threads()
    with pytest.raises(SystemExit) as ended:
        raster_bench.main()
    numba.set_num_threads(threads[0])
    torch.set_num_threads(threads[1])
    assert capsys.readouterr().out == "cuda\n"
    assert str(cuda_fault()) in str(ended.value)
    assert "\n" not in str(ended.value)
