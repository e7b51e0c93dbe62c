"""The rasteriser's kernels as GPUs will run them: none spills, and enough blocks fit on a multiprocessor."""

from __future__ import annotations

from pathlib import Path

import pytest

from streamlod.core.render.warp.kernels import blend, blend_adjoint, clear, project, project_adjoint
from tests.device.cubins import ARCHITECTURES, usage

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

MODULES = {module.__name__.split(".")[-1]: module for module in (blend, blend_adjoint, clear, project, project_adjoint)}
# 64 registers let four blocks of 256 onto a multiprocessor, 96 two.
MOST = {
    "blend": 64,
    "differentiate_blend": 96,
    "project": 64,
    "differentiate_projection": 128,  # once a Gaussian and not once a pixel: latency matters little
    "find_ranges": 32,
    "clear_list": 32,
}


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("name", MODULES)
def test_kernels_fit_into_registers(name: str, architecture: int, tmp_path: Path) -> None:
    found = usage(MODULES[name], architecture, tmp_path)
    assert found
    assert {kernel: use.stack for kernel, use in found.items() if use.stack} == {}
    assert {kernel: use.registers for kernel, use in found.items() if use.registers > MOST[kernel]} == {}
