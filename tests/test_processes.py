"""Tests report from several processes as they do from one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FIRST = "def test_it():\n    print('what it said')\n    assert False\n"
OTHERS = "import os\nimport pytest\nCOLLECTED = os.getpid()\n"
SECOND = OTHERS + (
    "@pytest.mark.parametrize('number', range(3))\n"
    "def test_it(number, tmp_path):\n    (tmp_path / 'file').touch()\n"
    "    assert (os.getpid() != COLLECTED) == {copied}\n"
)
THIRD = OTHERS + "def test_it():\n    pytest.skip('not here')\n"


def run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "tests.processes",
        "-c",
        os.devnull,
        "--rootdir",
        str(folder),
        str(folder),
    ]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    return subprocess.run([*command, *options], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_results_are_those_of_one_process(tmp_path: Path, count: int) -> None:
    for name, text in {"first": FIRST, "second": SECOND.format(copied=count > 1), "third": THIRD}.items():
        (tmp_path / f"test_{name}.py").write_text(text)
    done = run(tmp_path, f"--processes={count}")
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done
    assert "1 failed, 3 passed, 1 skipped" in done.stdout
    assert "what it said" in done.stdout


def test_a_process_that_dies_is_told_with_its_test(tmp_path: Path) -> None:
    (tmp_path / "test_dying.py").write_text(OTHERS + "def test_it():\n    os._exit(0)\n")
    done = run(tmp_path, "--processes=2")
    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    assert "a process died in test_dying.py::test_it" in done.stdout


def test_no_file_is_begun_after_the_failure_that_ends_the_run(tmp_path: Path) -> None:
    for number in range(20):
        (tmp_path / f"test_{number:02}.py").write_text(FIRST)
    done = run(tmp_path, "--processes=2", "-x")
    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    assert done.stdout.count("what it said") < 10


def test_threads_that_copies_would_lack_are_refused(tmp_path: Path) -> None:
    (tmp_path / "test_threaded.py").write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\ndef test_it(): ...\n"
    )
    assert "threads do not live on in a copy" in run(tmp_path, "--processes=2").stdout
