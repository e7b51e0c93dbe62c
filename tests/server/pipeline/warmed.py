"""Goes through all warm-ups, trains, and writes as JSON what they left uncompiled; run in a process of its own."""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys

from numba.core.dispatcher import Dispatcher

from streamlod.core.initialise import first_points
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.server.pipeline.rehearsal import rehearse
from streamlod.server.pipeline.warming import WARM_UPS


def kernels() -> dict[str, Dispatcher]:
    """All compiled functions of core and codec, by module and name."""
    for package in ("streamlod.core", "streamlod.codec"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            importlib.import_module(module.name)
    modules = {
        name: module for name, module in sys.modules.items() if name.startswith(("streamlod.core.", "streamlod.codec."))
    }
    found = [value for module in modules.values() for value in vars(module).values() if isinstance(value, Dispatcher)]
    return {f"{kernel.py_func.__module__}.{kernel.py_func.__name__}": kernel for kernel in found}


def called(kernel: Dispatcher) -> list[Dispatcher]:
    """Compiled functions that this one calls by name: they are compiled into it, and show no signature of their own."""
    names = kernel.py_func.__code__.co_names
    found = [kernel.py_func.__globals__.get(name) for name in names]
    return [value for value in found if isinstance(value, Dispatcher)]


def main() -> None:
    for warm_up in WARM_UPS.values():
        warm_up()
    every = kernels()
    before = {name: len(kernel.signatures) for name, kernel in every.items()}
    waiting, reached = [kernel for kernel in every.values() if kernel.signatures], set[int]()
    while waiting:
        kernel = waiting.pop()
        if id(kernel) not in reached:
            reached.add(id(kernel))
            waiting += called(kernel)
    rehearse("live", "cpu")
    clip = open_synthetic(SyntheticSpec(cameras=4, frames=1, width=72, height=40))
    first_points(next(iter(clip.frames())), clip.cameras, depth_bounds=clip.depth_bounds)
    cold = sorted(name for name, kernel in every.items() if id(kernel) not in reached)
    late = sorted(name for name, kernel in every.items() if len(kernel.signatures) > before[name])
    sys.stdout.write(json.dumps({"kernels": len(every), "cold": cold, "late": late}) + "\n")


if __name__ == "__main__":
    main()
