"""`streamlod doctor` says what works by trying it, and finds planted faults."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from streamlod.core.render import backends
from streamlod.server.doctor import backends as checks
from streamlod.server.doctor.finding import Finding, Verdict
from streamlod.server.doctor.host import check_host
from streamlod.server.doctor.report import as_json, as_table, worst

NO_GPU = not torch.cuda.is_available()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "streamlod.server.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.long
@pytest.mark.skipif(not NO_GPU, reason="this machine has a GPU")
def test_a_gpu_that_was_asked_for_and_is_not_there_is_a_fault() -> None:
    done = run("doctor", "--quick", "--device", "cuda", "--port", "0", "--json")
    assert done.returncode == 1
    report = json.loads(done.stdout)
    assert report["verdict"] == "fault"
    (fault,) = [row for row in report["findings"] if row["verdict"] == "fault"]
    assert fault["check"] == "backend cuda"
    assert "CUDA" in fault["remedy"]


@pytest.mark.long
@pytest.mark.skipif(not NO_GPU, reason="this machine has a GPU")
def test_serving_on_a_gpu_that_is_not_there_ends_at_once() -> None:
    done = run("serve", "--synthetic", "cameras=3,frames=1", "--device", "cuda", "--port", "0")
    assert done.returncode == 2
    assert "CUDA" in done.stderr.strip().splitlines()[-1]


def test_the_cpu_backend_has_right_gradients() -> None:
    (finding,) = [f for f in checks.check_backends("cpu", quick=False) if f.check == "backend cpu"]
    assert finding.verdict is Verdict.OK, finding.found


def test_wrong_gradients_are_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    right = checks._gradients

    def wrong(backend: str, count: int, size: tuple[int, int]) -> list[torch.Tensor]:
        gradients = right(backend, count, size)  # type: ignore[arg-type]
        return gradients if backend == "reference" else [1.01 * gradient for gradient in gradients]

    monkeypatch.setattr(checks, "_gradients", wrong)
    finding = checks._measured("cpu")
    assert finding.verdict is Verdict.FAULT
    assert "1.0e-02" in finding.found


@pytest.mark.skipif(not NO_GPU, reason="this machine has a GPU")
def test_an_idle_gpu_is_told_of(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(backends, "has_nvidia_device", lambda: True)
    assert backends.select("auto") == "cpu"
    assert "the CPU is used" in caplog.text
    (finding,) = [f for f in checks.check_backends("auto", quick=True) if f.check == "backend cuda"]
    assert finding.verdict is Verdict.WARNING


def test_a_port_in_use_and_a_folder_that_cannot_be_made_are_found(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        found = {finding.check: finding for finding in check_host("127.0.0.1", listener.getsockname()[1], tmp_path)}
    port = next(finding for check, finding in found.items() if check.startswith("port"))
    assert port.verdict is Verdict.WARNING
    assert "--port" in port.remedy
    assert found[f"disk {tmp_path}"].verdict in (Verdict.OK, Verdict.WARNING)


def test_the_report_names_the_worst() -> None:
    findings = [Finding("a", Verdict.OK, "1"), Finding("bb", Verdict.WARNING, "2", "mend it")]
    assert worst(findings) is Verdict.WARNING
    assert as_table(findings).splitlines()[:3] == ["a   ok       1", "bb  warning  2", f"{'':13}-> mend it"]
    assert json.loads(as_json(findings))["findings"][1]["remedy"] == "mend it"
