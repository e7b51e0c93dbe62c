"""How much of the process's time the rasteriser's and the loss's kernels had."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any, Self

import streamlod.core.render.cpu.backdrop
import streamlod.core.render.cpu.frame
import streamlod.core.render.cpu.listing
import streamlod.core.render.cpu.photometric

_FRAME, _LISTING = streamlod.core.render.cpu.frame, streamlod.core.render.cpu.listing
_KERNELS: dict[str, tuple[tuple[ModuleType, str], ...]] = {
    "project": ((_LISTING, "project"),),
    "list": (
        (_LISTING, "_depth_order"),
        (_LISTING, "count_pairs"),
        (_LISTING, "fill_lists"),
        (_LISTING, "find_touching"),
        (streamlod.core.render.cpu.backdrop, "merge_lists"),
    ),
    "blend": ((_FRAME, "blend_tiles"),),
    "gradients": ((_FRAME, "differentiate_tiles"), (_FRAME, "differentiate_projection")),
    "loss": ((streamlod.core.render.cpu.photometric, "photometric"),),
}


class KernelTime:
    """While it is entered, adds up the time inside of kernels by `clock`, by group."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self._clock = clock
        self.seconds = dict.fromkeys(_KERNELS, 0.0)
        self._originals: list[tuple[ModuleType, str, Any]] = []

    @property
    def total(self) -> float:
        """All groups together."""
        return sum(self.seconds.values())

    def __enter__(self) -> Self:
        for group, kernels in _KERNELS.items():
            for module, name in kernels:
                kernel = getattr(module, name)
                self._originals.append((module, name, kernel))
                setattr(module, name, self._timed(group, kernel))
        return self

    def __exit__(self, *_: object) -> None:
        for module, name, kernel in self._originals:
            setattr(module, name, kernel)

    def _timed(self, group: str, kernel: Any) -> Any:
        def timed(*arguments: Any) -> Any:
            begin = self._clock()
            result = kernel(*arguments)
            self.seconds[group] += self._clock() - begin
            return result

        return timed
