"""gsply, a program for files of Gaussians that is not ours, uncompiled: to compile its kernels takes ten seconds."""

from __future__ import annotations

import numba

numba.config.DISABLE_JIT = True  # type: ignore[attr-defined]
try:
    import gsply
finally:
    numba.config.DISABLE_JIT = False  # type: ignore[attr-defined]

__all__ = ["gsply"]
