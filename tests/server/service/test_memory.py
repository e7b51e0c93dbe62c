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
import server.service.run, server.worker.process
from server.pipeline.warming import warm_codec
from server.service.memory import leave_out_linear_algebra, page_out_compiler

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


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_server_at_rest_is_small(tmp_path: Path) -> None:
    with serving(tmp_path / "log") as (pid, _):
        before = -1.0
        while cpu_seconds(pid) - before > 0.05:  # until its kernels are loaded
            before = cpu_seconds(pid)
            time.sleep(0.5)
        resident, own = megabytes(pid)
        # the rest are libraries, LLVM above all, which stay in memory for as long as other processes use them
        assert own < _MAX_OWN_MEGABYTES
        assert own < resident
