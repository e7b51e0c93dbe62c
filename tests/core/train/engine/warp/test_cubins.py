"""A training step's kernels as GPUs will run them: none spills, and enough threads fit on a multiprocessor."""

from __future__ import annotations

from pathlib import Path

import pytest

from streamlod.core.train.engine.warp.kernels import adam, added, decode, loss, rate
from tests.device.cubins import ARCHITECTURES, usage

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

MODULES = {module.__name__.split(".")[-1]: module for module in (adam, added, decode, loss, rate)}
# Registers; 64 for the others. Decoding happens once a Gaussian and not once a pixel: latency matters little.
MOST = {"decode": 128, "differentiate_decode": 128, "differentiate_added": 128}


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("name", MODULES)
def test_kernels_fit_into_registers(name: str, architecture: int, tmp_path: Path) -> None:
    found = usage(MODULES[name], architecture, tmp_path)
    assert found
    assert {kernel: use.stack for kernel, use in found.items() if use.stack} == {}
    assert {kernel: use.registers for kernel, use in found.items() if use.registers > MOST.get(kernel, 64)} == {}
