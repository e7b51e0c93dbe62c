"""Measures to keep the serving process small: it runs kernels that others have compiled, and needs no compiler."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import re
import sys
from pathlib import Path

_M_ARENA_MAX = -8  # of malloc.h
_MADV_PAGEOUT = 21  # of linux/mman.h
_COMPILER = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) r.*/libllvmlite\.so$", re.MULTILINE)


def bound_arenas() -> None:
    """Let threads share glibc's heap: states are decoded on several, and each would keep freed memory of its own."""
    with contextlib.suppress(OSError, AttributeError):  # not glibc
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def leave_out_linear_algebra() -> None:
    """Let Numba load without `scipy.linalg`: 16 MB, for functions that none of the codec's kernels calls."""
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]
    try:
        importlib.import_module("numba.np.arraymath")  # which looks for it once
    finally:
        del sys.modules["scipy.linalg"]


def page_out_compiler() -> None:
    """Let the system have the 70 MB of LLVM that loading kernels has touched and running them does not.

    They are pages of a file, so what is needed once more comes back by itself. Pages that another process uses stay.
    """
    with contextlib.suppress(OSError, AttributeError):  # no Linux
        advise = ctypes.CDLL(None).madvise
        for begin, end in _COMPILER.findall(Path("/proc/self/maps").read_text(encoding="utf-8")):
            start = int(begin, 16)
            advise(ctypes.c_void_p(start), ctypes.c_size_t(int(end, 16) - start), _MADV_PAGEOUT)
