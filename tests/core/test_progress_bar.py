"""Bars of long work."""

from __future__ import annotations

import pytest

from streamlod.core.progress_bar import progress_bar


def test_a_log_gets_a_few_lines_of_long_work(capsys: pytest.CaptureFixture[str]) -> None:
    """Standard error is no terminal here."""
    with progress_bar(total=10_000, unit="picture", desc="looking") as bar:
        for _ in range(10_000):
            bar.update()
    drawn = capsys.readouterr().err
    assert drawn.count("looking") <= 5
    assert "10000/10000" in drawn
