"""Which backend renders."""

from __future__ import annotations

import functools
import importlib.util
import shutil
from typing import Literal

from core.errors import BackendUnavailable

Backend = Literal["cpu", "cuda", "reference"]
_REMEDY = "choose the device cpu"


def select(device: str = "auto") -> Backend:
    """The backend for `device`: ``cpu``, ``cuda``, or ``auto`` for cuda where it works and cpu elsewhere.

    Raises:
        BackendUnavailable: cuda was asked for and cannot work here; says what is missing.
        ValueError: another word.
    """
    if device == "cpu":
        return "cpu"
    if device not in ("auto", "cuda"):
        raise ValueError(f"device must be auto, cpu or cuda, not {device!r}")
    missing = cuda_fault()
    if missing is None:
        return "cuda"
    if device == "auto":
        return "cpu"
    raise BackendUnavailable("the cuda backend", missing)


@functools.cache
def cuda_fault() -> str | None:
    """What keeps the cuda backend from working, as advice; None where nothing does."""
    if importlib.util.find_spec("torch") is None:
        return f"install torch built for CUDA, or {_REMEDY}"
    import torch

    if not torch.cuda.is_available():
        return f"torch finds no CUDA device: install a driver and torch built for CUDA, or {_REMEDY}"
    if importlib.util.find_spec("gsplat") is None:
        return f"install gsplat>=1.5.3,<1.6, or {_REMEDY}"
    if shutil.which("nvcc") is None and not _gsplat_is_compiled():
        return f"gsplat compiles its kernels at first use and finds no nvcc: install the CUDA toolkit, or {_REMEDY}"
    return None


def _gsplat_is_compiled() -> bool:
    """Whether gsplat brought its kernels as a compiled module, as its own wheels for CUDA do."""
    return importlib.util.find_spec("gsplat.csrc") is not None
