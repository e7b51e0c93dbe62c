"""Differences from ours, beside the published ones."""

from __future__ import annotations

from typing import Any

import pytest

from streamlod.client.evaluation.report.verdicts import PUBLISHED, agrees, paired, verdict_table


def run(seed: int, psnr: float, size: float | None = 1000.0) -> dict[str, Any]:
    return {
        "seed": seed, "psnr": psnr, "predicted_bytes_mean": size, "predicted_cpu_seconds": 2.0, "render_fps": 50.0,
        "stream_bytes": None if size is None else size + 500,
    }  # fmt: skip


def test_published_differences_are_those_of_the_paper() -> None:
    assert PUBLISHED["one level"].psnr == pytest.approx(20.02 - 22.73)
    assert PUBLISHED["no quantisation"].bytes == pytest.approx(1.683 / 0.205)


def test_runs_are_paired_by_seed() -> None:
    (first, second) = paired([run(0, 20), run(1, 21)], [run(1, 22, 500), run(0, 19.5), run(2, 30)])
    assert (first.psnr, first.bytes, second.psnr) == (1, 0.5, -0.5)
    assert first.stream == pytest.approx(1000 / 1500)
    assert paired([run(0, 20)], [run(0, 21, None)])[0].bytes is None


@pytest.mark.parametrize(
    ("name", "values", "published", "expected"),
    [
        ("psnr", [-0.5, -0.6], -2.7, True),
        ("psnr", [0.5, 0.6], -2.7, False),
        ("psnr", [-0.5, 0.4], -2.7, None),  # seeds disagree
        ("psnr", [-0.2], -2.7, None),  # one seed
        ("psnr", [-0.4], -2.7, True),
        ("psnr", [0.01, 0.01], 0.4, None),
        ("bytes", [8.0, 8.1], 8.2, True),
        ("bytes", [0.7], 1.4, False),
        ("seconds", [1.0, 1.01], 1.2, None),
    ],
)
def test_a_verdict_needs_a_difference_that_stands_out(
    name: str, values: list[float], published: float, expected: bool | None
) -> None:
    assert agrees(name, values, published) is expected


def test_the_table_names_both() -> None:
    rows = [
        {"name": "ours", "seeds": [run(0, 22)]},
        {"name": "paper", "seeds": [run(0, 20)]},
        {"name": "paper star", "seeds": [run(0, 19)]},
        {"name": "one level", "seeds": [run(0, 20)]},
    ]
    text = verdict_table(rows)
    assert "-2.00 (-2.71: as published)" in text
    assert "| paper | -2.00 | x 1.00" in text
    assert "| paper star | -1.00 (-0.35: as published)" in text
