"""What the serving process leaves out of its memory, and that it works without."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.bench.idle_bench import cpu_seconds, megabytes, serving

_RUN = """
import re, sys
from pathlib import Path
import streamlod.server.service.run, streamlod.server.worker.process
from streamlod.server.pipeline.warming import warm_codec
from streamlod.server.service.memory import leave_out_linear_algebra, page_out_compiler

def resident():
    return int(re.search(r"^Rss:\\s+(\\d+)", Path("/proc/self/smaps_rollup").read_text(), re.MULTILINE)[1])

leave_out_linear_algebra()
warm_codec()
before = resident()
page_out_compiler()
after = resident()
warm_codec()  # the kernels still run
heavy = ("scipy.linalg", "jwt", "cryptography", "torch", "cv2", "av")
print([name for name in heavy if name in sys.modules], after <= before)
import scipy.linalg  # others can still have it
"""
_MAX_OWN_MEGABYTES = 115


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_serving_loads_no_more_than_it_needs() -> None:
    found = subprocess.run([sys.executable, "-c", _RUN], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[] True"


def megabytes_at_rest(log: Path) -> tuple[float, float]:
    """What a server has resident once its kernels are loaded, and what of it is its own."""
    with serving(log) as (pid, _):
        before, quiet = cpu_seconds(pid), 0
        while quiet < 4:  # looks in a row: while it loads its kernels it may get no processor for a moment, too
            time.sleep(0.5)
            used, is_loading = cpu_seconds(pid), "/libllvmlite.so" not in Path(f"/proc/{pid}/maps").read_text()
            quiet, before = 0 if is_loading or used - before > 0.05 else quiet + 1, used
        return megabytes(pid)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_server_at_rest_is_small(tmp_path: Path) -> None:
    """The rest are libraries, LLVM above all, which stay in memory for as long as other processes use them.

    Where such a process ends after the server has given its pages of LLVM back, they are the server's own: once more.
    """
    for _ in range(5):
        resident, own = megabytes_at_rest(tmp_path / "log")
        if own < _MAX_OWN_MEGABYTES:
            break
    assert own < _MAX_OWN_MEGABYTES
    assert own < resident
