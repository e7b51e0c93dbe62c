"""Bounds of what a packet costs the page: as `tests.codec.test_bounds`, in a process of little memory."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.codec.hostile import densest, hostile, stream_bytes

SCRIPT = Path(__file__).with_name("cost.mjs")
FUZZER = Path(__file__).parents[2] / "fuzz" / "run_page.mjs"
HEAP_MEBIBYTES = 64  # of JavaScript objects; arrays of numbers lie outside and are counted with the whole process
MEBIBYTES = 48  # by which the process may grow at most


def _cost(node: str, path: Path, packets: list[bytes]) -> tuple[str, int, float]:
    """Refusal code of the last packet, the blocks of code that were run, and MiB by which the process grew."""
    path.write_bytes(stream_bytes(packets))
    command = [node, "--no-opt", "--no-sparkplug", f"--max-old-space-size={HEAP_MEBIBYTES}", str(SCRIPT), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    code, blocks, mebibytes = json.loads(done.stdout)
    return code, blocks, mebibytes


@pytest.mark.long
def test_what_announces_too_much_costs_nothing(node: str, tmp_path: Path) -> None:
    for name, packets in hostile().items():
        code, blocks, mebibytes = _cost(node, tmp_path / "a.slps", packets)
        assert code == "limit_exceeded", name
        assert blocks < 10_000 + 100 * len(packets[-1]), name
        assert mebibytes < 32, name


@pytest.mark.long
def test_the_densest_packets_cost_in_proportion(node: str, tmp_path: Path) -> None:
    """Rows for nothing, as many as the bytes allow: four times the bytes take no more than that of the work."""
    work = []
    for rows in (10_000, 40_000):
        packets = densest(rows)
        code, blocks, mebibytes = _cost(node, tmp_path / "a.slps", packets)
        assert code == "accepted"
        assert blocks < 10_000 + 100 * len(packets[-1])
        assert mebibytes < MEBIBYTES
        work.append(blocks)
    assert work[1] < 4.1 * work[0]


@pytest.mark.long
@pytest.mark.parametrize("target", ["packet", "container", "session"])
def test_mutants_are_taken_or_refused(node: str, target: str) -> None:
    """A second of what tests/fuzz/run_page.mjs does for longer."""
    command = [node, "--max-old-space-size=256", str(FUZZER), target, "1", "7"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "no finding" in done.stdout
