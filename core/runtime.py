"""The settings of the process that must be in place before torch and numba load.

Both libraries read them once, when they are first imported, and share one OpenMP runtime from then on, so this runs at
the import of `core`, which every entry point makes first. A setting that is already in the environment is left alone.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import re
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

_LOG = logging.getLogger(__name__)
_CACHE_BYTES = 128 << 20  # that all kernels take, and some more
_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(r"^(?:from ([\w.]+) import \(?([\w, ]*)|import ([\w.]+))", re.MULTILINE)


def prepare_environment() -> None:
    """Set what numba and OpenMP read at import.

    * ``OMP_WAIT_POLICY=PASSIVE``: by default idle OpenMP threads spin, which on a machine with other work costs more
      than it saves (a training step took 3x the CPU time on two busy cores).
    * ``GOMP_SPINCOUNT=1000``: with that policy, still look again for some microseconds before sleeping. A step has some
      thirty parallel parts, and waking a thread for each costs more (a frame of 50 steps took 0.92 s without, 0.78 s
      with, and less CPU time too; longer looks only cost).
    * ``NUMBA_THREADING_LAYER=omp``: the default layer, workqueue, aborts the process when two threads render at once,
      as a viewer beside a trainer does.
    * ``NUMBA_NUM_THREADS``: what ``OMP_NUM_THREADS`` says, if it is set. With all cores in its place, the first kernel
      would raise torch's number of threads too, in its own thread alone: two trainings of a process would differ.
    * ``NUMBA_CACHE_DIR``: a folder that outlives checkouts and virtual environments, so that kernels compile once.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if os.environ["OMP_WAIT_POLICY"].upper() == "PASSIVE":
        os.environ.setdefault("GOMP_SPINCOUNT", "1000")
    os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
    threads = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()  # of nested parts, the outermost
    if threads.isdecimal() and int(threads) > 0:
        os.environ.setdefault("NUMBA_NUM_THREADS", threads)
    if "NUMBA_CACHE_DIR" not in os.environ:  # else a parent has found it, which takes reading all kernels' sources
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_cache_folder())
    if fault := cache_fault(Path(os.environ["NUMBA_CACHE_DIR"])):
        _LOG.warning("compiled kernels cannot be kept (%s), so every start compiles them anew, which takes minutes; "
                     "name another folder in XDG_CACHE_HOME", fault)  # fmt: skip
        _compile_without_cache()
    if not _has_openmp():
        _LOG.warning("GNU's OpenMP is missing, so that nothing can be trained or drawn here; install it: "
                     "apt-get install libgomp1, or dnf install libgomp")  # fmt: skip
    numba = sys.modules.get("numba")
    if numba is not None:  # someone else loaded it first and it has read its settings, but not used these yet
        numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
        numba.config.THREADING_LAYER = os.environ["NUMBA_THREADING_LAYER"]


def _has_openmp() -> bool:
    """Whether numba finds GNU's OpenMP: on Linux it takes the system's; elsewhere its wheels bring one."""
    if sys.platform != "linux":
        return True
    try:
        ctypes.CDLL("libgomp.so.1.0.0")
    except OSError:
        return False
    return True


def cache_fault(folder: Path) -> str:
    """Why a folder that may not be there yet takes no kernels; empty if it does. Nothing is made."""
    existing = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    try:
        if not os.access(existing, os.W_OK | os.X_OK):
            return f"{existing} cannot be written"
        free = shutil.disk_usage(existing).free
    except OSError as error:
        return f"{existing}: {error.strerror}"
    return "" if free >= _CACHE_BYTES else f"the disk of {existing} has {free >> 20} MiB left"


def _compile_without_cache() -> None:
    """Have Numba use what a cache holds, and go on where it takes nothing more; by default it refuses every kernel."""
    from numba.core import caching, dispatcher

    class Cache(caching.FunctionCache):
        def save_overload(self, sig: object, data: object) -> None:
            with suppress(OSError):
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def enable_caching(self: Any) -> None:
        with suppress(RuntimeError):  # there is no folder for it
            self._cache = Cache(self.py_func)  # type: ignore[no-untyped-call]

    dispatcher.Dispatcher.enable_caching = enable_caching  # type: ignore[method-assign]


def kernel_cache_folder() -> Path:
    """Where compiled kernels are kept: below ``XDG_CACHE_HOME`` (``~/.cache``), a folder a version of the kernels.

    Numba notices a change of the file that calls a kernel only, and code that mixes two versions of kernels writes
    where it must not. So the folder's name is a digest of all sources that compiled code can come from.
    """
    digest = hashlib.blake2b(digest_size=6)
    for source in kernel_sources(_ROOT).values():
        digest.update(source)
    return cache_folder() / "numba" / digest.hexdigest()


def cache_folder() -> Path:
    """Where streamlod keeps what it can make again: below ``XDG_CACHE_HOME`` (``~/.cache``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "streamlod"


def kernel_sources(root: Path) -> dict[str, bytes]:
    """Sources of the modules in `root`'s core and codec that numba compiles, and of what these import, by name."""
    sources = {}
    for package in ("core", "codec"):
        for path in (root / package).rglob("*.py"):
            sources[".".join(("streamlod", *path.relative_to(root).with_suffix("").parts))] = path.read_bytes()
    # every process of streamlod comes through here: plain searches first, and imports only of what is reached
    waiting = [
        name
        for name, source in sources.items()
        if (b"njit" in source and re.search(rb"\bnjit\(", source))
        or (b"coder.compiled" in source and "streamlod.codec.coder.compiled" in _imported(source))
    ]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting.extend(_imported(sources[name]) & sources.keys())
    return {name: sources[name] for name in sorted(found)}


def _imported(source: bytes) -> set[str]:
    """Names of modules that `source` may import at its top level."""
    names = set()
    for package, members, module in _IMPORT.findall(source.decode()):
        names.add(module or package)
        names.update(f"{package}.{member.strip()}" for member in members.split(","))
    return names
