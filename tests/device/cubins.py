"""Kernels compiled for GPUs that are not here: registers and spilled bytes, as NVIDIA's cuobjdump tells them."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
import warp as wp

ARCHITECTURES = (80, 90, 120)  # A100; H100 and H200; GeForce RTX 50
_FUNCTION = re.compile(r"Function (\w+?)_[0-9a-f]{8}_cuda_kernel_forward:\s*REG:(\d+) STACK:(\d+)")


@dataclass(frozen=True)
class Usage:
    """What one thread of a kernel uses: registers, and bytes of the stack, where what has no register lies."""

    registers: int
    stack: int


def usage(module: ModuleType, architecture: int, folder: Path) -> dict[str, Usage]:
    """Compile the kernels of `module` into `folder`, without a GPU or a driver; what each of them takes."""
    files = wp.compile_aot_module(module, arch=architecture, module_dir=folder, use_ptx=False)
    (cubin,) = (file for file in map(Path, files) if file.suffix == ".cubin")
    command = [_cuobjdump(), "--dump-resource-usage", str(cubin)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {name: Usage(int(registers), int(stack)) for name, registers, stack in _FUNCTION.findall(done.stdout)}


def _cuobjdump() -> str:
    found = importlib.util.find_spec("nvidia")
    for folder in [] if found is None else found.submodule_search_locations or []:
        for program in Path(folder).glob("*/bin/cuobjdump"):
            return str(program)
    if program := shutil.which("cuobjdump"):
        return program
    pytest.skip("there is no cuobjdump: install nvidia-cuda-cuobjdump")
