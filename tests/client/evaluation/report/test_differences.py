"""Differences of systems from ours."""

from __future__ import annotations

from typing import Any

import pytest

from streamlod.client.evaluation.report.differences import differences_table, paired


def run(seed: int, psnr: float, size: float | None = 1000.0) -> dict[str, Any]:
    return {
        "seed": seed, "psnr": psnr, "predicted_bytes_mean": size, "predicted_cpu_seconds": 2.0, "render_fps": 50.0,
        "stream_bytes": None if size is None else size + 500,
    }  # fmt: skip


def test_runs_are_paired_by_seed() -> None:
    (first, second) = paired([run(0, 20), run(1, 21)], [run(1, 22, 500), run(0, 19.5), run(2, 30)])
    assert (first.psnr, first.bytes, second.psnr) == (1, 0.5, -0.5)
    assert first.stream == pytest.approx(1000 / 1500)
    assert paired([run(0, 20)], [run(0, 21, None)])[0].bytes is None


def test_each_system_is_compared_with_its_base() -> None:
    rows = [
        {"name": "ours", "seeds": [run(0, 22)]},
        {"name": "paper", "seeds": [run(0, 20)]},
        {"name": "paper star", "seeds": [run(0, 19)]},
        {"name": "one level", "seeds": [run(0, 20)]},
    ]
    text = differences_table(rows)
    assert "| one level | -2.00 | x 1.00" in text
    assert "| paper | -2.00 | x 1.00" in text
    assert "| paper star, from paper | -1.00 | x 1.00" in text
