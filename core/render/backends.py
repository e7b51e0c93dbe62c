"""Which backend renders."""

from __future__ import annotations

import functools
import importlib.util
import logging
import os
import shutil
from pathlib import Path
from typing import Literal

from streamlod.core.errors import BackendUnavailable

Backend = Literal["cpu", "cuda", "warp", "reference"]
_REMEDY = "choose the device cpu"
GPU = "cuda"  # torch's name of the device that the backends of GPUs compute on
ON_GPU: tuple[Backend, ...] = ("cuda", "warp")
_LOG = logging.getLogger(__name__)


def select(device: str = "auto") -> Backend:
    """The backend for `device`: ``cpu``, ``cuda``, or ``auto`` for cuda where it works and cpu elsewhere.

    Where gsplat does not work, a GPU that is asked for by name is drawn on by Warp, which needs a driver alone.

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
        if has_nvidia_device():
            other = "; or name the device cuda, and NVIDIA Warp draws" if has_warp() else ""
            _LOG.warning("there is an NVIDIA GPU, but the CPU is used: %s%s", missing, other)
        return "cpu"
    if has_warp():
        _LOG.warning("NVIDIA Warp draws, which no GPU has run yet, as gsplat cannot: %s", missing)
        return "warp"
    raise BackendUnavailable("the cuda backend", missing)


def has_warp() -> bool:
    """Whether Warp can draw on a GPU here."""
    return warp_fault() is None


def warp_fault() -> str | None:
    """Advice about what keeps Warp from drawing on a GPU; None where nothing does."""
    if (missing := _torch_fault()) is not None:
        return missing
    if importlib.util.find_spec("warp") is None:
        return f"install warp-lang>=1.19,<1.20, or {_REMEDY}"
    from streamlod.core.render.warp import finds_gpu

    try:
        if finds_gpu():
            return None
    except OSError as error:
        return f"NVIDIA Warp cannot keep its kernels ({error}): name another folder in XDG_CACHE_HOME, or {_REMEDY}"
    return (
        f"NVIDIA Warp cannot use this driver: install a newer one, or {_REMEDY}"  # its CUDA may be newer than torch's
    )


def _torch_fault() -> str | None:
    """Advice about what keeps torch from computing on a GPU; None where nothing does."""
    if importlib.util.find_spec("torch") is None:
        return f"install torch built for CUDA, or {_REMEDY}"
    import torch

    if not torch.cuda.is_available():
        return f"torch finds no CUDA device: install a driver and torch built for CUDA, or {_REMEDY}"
    return None


@functools.cache
def cuda_fault() -> str | None:
    """Advice about what keeps the cuda backend, which is gsplat, from working; None where nothing does."""
    if (missing := _torch_fault()) is not None:
        return missing
    if importlib.util.find_spec("gsplat") is None:
        return f"install gsplat>=1.5.3,<1.6, or {_REMEDY}"
    if shutil.which("nvcc") is None and not _gsplat_is_compiled() and not _gsplat_was_built():
        return f"gsplat compiles its kernels at first use and finds no nvcc: install the CUDA toolkit, or {_REMEDY}"
    return None


def _gsplat_is_compiled() -> bool:
    """Whether gsplat brought its kernels as a compiled module, as its own wheels for CUDA do."""
    return importlib.util.find_spec("gsplat.csrc") is not None


def _gsplat_was_built() -> bool:
    """Whether gsplat has compiled its kernels here before: then it loads them without a compiler."""
    from torch.utils.cpp_extension import get_default_build_root

    root = Path(os.environ.get("TORCH_EXTENSIONS_DIR") or get_default_build_root())
    return any(root.rglob("gsplat_cuda.so"))


def has_nvidia_device() -> bool:
    """Whether the system shows an NVIDIA GPU, with or without a torch that can use it."""
    files = (Path("/dev/nvidiactl"), Path("/dev/dxg"))  # Linux, and Linux inside Windows
    return any(file.exists() for file in files) or shutil.which("nvidia-smi") is not None
