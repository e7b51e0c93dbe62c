"""The programs about the step in Warp, at a small size on the CPU."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.bench import gpu_day, step_cost
from tests.bench.gpu_day import SMALL
from tests.bench.step_subject import Sizes, make_step, told


def test_a_step_has_few_nodes() -> None:
    step = make_step(SMALL, "cpu")
    step.tell(0, told(0, SMALL.width * SMALL.height), (0,))
    nodes = step_cost.nodes_of(step)
    assert nodes["kernels"] == 17
    assert sum(nodes.values()) <= 25


def test_costs_name_every_kernel(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    small = ["--size", "96x54", "--anchors", "300", "--moving", "40", "--cameras", "3"]
    monkeypatch.setattr(sys, "argv", ["step_cost", *small])
    step_cost.main()
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert rows[-1].startswith("| step |")
    assert len(rows) == 2 + 12 + 1


def test_a_gpu_day_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "figures.json"
    file.write_text(json.dumps({name: {"done": True} for name in gpu_day.PARTS if name != "steps"}))
    arguments = ["gpu_day", "--device", "cpu", "--small", "--json", str(file)]
    monkeypatch.setattr(sys, "argv", arguments)
    monkeypatch.setattr(gpu_day, "STEPS", 3)
    gpu_day.main()
    found = json.loads(file.read_text())
    assert found["drawing"] == {"done": True}
    assert found["steps"]["ms, replayed"] > 0
    assert found["steps"]["overflow"] == 0
    assert "| steps | |" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*arguments, "nothing"])
    with pytest.raises(SystemExit):
        gpu_day.main()


def test_a_gpu_day_tries_again_what_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(device: str, sizes: Sizes) -> gpu_day.Figures:
        raise RuntimeError(f"no {device}")

    file = tmp_path / "figures.json"
    monkeypatch.setattr(gpu_day, "PARTS", {"steps": broken, "device": gpu_day.device_part})
    monkeypatch.setattr(sys, "argv", ["gpu_day", "--device", "cpu", "--small", "--json", str(file)])
    gpu_day.main()
    found = json.loads(file.read_text())
    assert found["steps"]["failed"] == "RuntimeError: no cpu"
    assert found["device"]["warp"]
    gpu_day.PARTS["steps"] = gpu_day.correctness
    gpu_day.main()
    found = json.loads(file.read_text())["steps"]
    assert found.pop("seconds") > 0
    assert not any(found.values())  # the CPU differs from itself in nothing


def test_the_last_line_of_a_program_is_told_or_why_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def said(program: str) -> str:
        return gpu_day._said(sys.executable, "-c", program)

    assert said("print('one\\ntwo')") == "two"
    assert said("raise SystemExit('no')") == "no, exit code 1"
    assert said("raise SystemExit(3)") == "exit code 3"
    assert "nowhere" in gpu_day._said("/nowhere")
    monkeypatch.setattr(gpu_day, "MAX_SECONDS", 0.1)
    assert said("import threading; threading.Event().wait()") == "stopped after 0.1 s"
