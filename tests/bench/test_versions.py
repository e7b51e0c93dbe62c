"""What the comparison of versions runs, and what it prints."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.bench.versions_bench import ROOT, extracted, main, report, run

pytestmark = pytest.mark.skipif(
    shutil.which("git") is None or not (ROOT / ".git").exists(), reason="versions come from git's history"
)


def test_each_version_imports_its_own_code(tmp_path: Path) -> None:
    source = extracted("HEAD", tmp_path / "now")
    for package in ("core", "server", "tests.server"):
        found = run(source, f"import {package}; print({package}.__file__)")
        assert Path(found.strip()).is_relative_to(source)


def test_an_unknown_commit_is_refused_in_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["versions_bench", "--before", "no-such-commit"])
    with pytest.raises(SystemExit):
        main()
    assert "no-such-commit" in capsys.readouterr().err


def test_ratios_are_of_each_round(capsys: pytest.CaptureFixture[str]) -> None:
    report("start", [1.0, 2.0, 4.0], [1.1, 1.8, 4.0], "s")
    numbers = [float(each) for each in re.findall(r"[0-9.]+", capsys.readouterr().out)]
    assert numbers == [2.0, 1.8, 1.0, 0.9, 1.1]  # medians of both and of the ratios, and their range
