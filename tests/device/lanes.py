"""Warp's kernels on the CPU as a GPU may run them: warps of 32 lanes that wait for each other, in random order.

Warp itself runs a kernel's threads one after the other there, so that races and lanes that do not meet never show. What
it generates for the CPU is compiled once more, around `lanes.h`.
"""

from __future__ import annotations

import copy
import ctypes
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from warp._src.context import ModuleExec

_HEADER = Path(__file__).with_name("lanes.h")
_LOOP = re.compile(
    r"for \(size_t task_index = 0; task_index < dim->size; \+\+task_index\)\s*"
    r"\{\s*(\w+<wp_linear_contiguous>\(\*dim, task_index, _wp_args\);)\s*\}"
)
# What `core.render.warp.kernels.lanes` has of a GPU, by the functions of the header that take its place.
_NATIVE = {
    "bool any_lane_0": "any(flag)",
    "wp::float32 lanes_sum_0": "sum(value)",
    "bool is_first_lane_0": "is_first()",
}


class LanesDiverge(AssertionError):
    """Lanes of a warp waited for others that had ended, or waited elsewhere."""


@contextmanager
def on_lanes(patch: pytest.MonkeyPatch, folder: Path) -> Iterator[dict[str, Any]]:
    """Let kernels run so; gives the library of each kernel that did, by its name in code.

    Raises:
        LanesDiverge: in the end, if any did.
    """
    if shutil.which("g++") is None:
        pytest.skip("there is no g++")
    hooks_of, compiled = ModuleExec.get_kernel_hooks, dict[str, Any]()

    def get_kernel_hooks(self: Any, kernel: Any) -> Any:
        hooks, name = copy.copy(hooks_of(self, kernel)), self.get_kernel_mangled_name(kernel)
        if name not in compiled:
            compiled[name] = _compiled(name, folder)
        hooks.forward = getattr(compiled[name], f"{name}_cpu_forward")
        return hooks

    with patch.context() as inside:
        inside.setattr(ModuleExec, "get_kernel_hooks", get_kernel_hooks)
        yield compiled
    if diverging := [name for name, library in compiled.items() if library.lanes_diverged()]:
        raise LanesDiverge(f"lanes do not meet in the modules of {', '.join(diverging)}")


def _compiled(name: str, folder: Path) -> Any:
    """The library with a kernel, whose source Warp keeps beside what it compiled."""
    entry = f"{name}_cpu_forward("
    kept = (path for path in Path(wp.config.kernel_cache_dir).rglob("*.cpp") if entry in path.read_text())
    source = max(kept, key=lambda path: path.stat().st_mtime)
    library = folder / f"{source.stem}.so"
    if not library.exists():
        text, loops = _LOOP.subn(r"lanes::run(dim->size, [&](size_t task_index) { \1 });", source.read_text())
        assert loops, f"Warp writes the loop over threads in another way: {source}"
        for function, body in _NATIVE.items():
            text = re.sub(
                rf"({function}\([^)]*\)\s*\{{).*?\n\}}", rf"\1 return lanes::{body}; }}", text, flags=re.DOTALL
            )
        own = library.with_suffix(".cpp")
        # first, as Warp makes functions of `float` and `int`; with the system's library, which Warp does without
        own.write_text(f'#include "{_HEADER}"\n' + text.replace("#define WP_NO_CRT", ""))
        native = Path(wp.__file__).parent / "native"
        command = ["g++", "-std=c++17", "-O1", "-w", "-shared", "-fPIC", f"-I{native}", str(own), "-o", str(library)]
        subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))
