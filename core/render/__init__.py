"""Rendering: one set of rules, three backends.

* `core.render.cpu`: numba kernels; its forward pass needs numpy and numba only, so that a client can use it.
* `core.render.cuda`: gsplat.
* `core.render.reference`: dense float64 torch, slow and obvious: the oracle of the other two.

`rasterise` is the training interface over all three. The rules (`docs/numerics.md`) are gsplat's but for a low-pass of
0.1 pixels^2: alpha in [1/255, 0.999]; a pixel ends when its transmittance would fall to 1e-4. Importing this package
loads nothing heavy: what needs torch is looked up when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from streamlod.core.render.backends import Backend, select

if TYPE_CHECKING:
    from streamlod.core.render.differentiable import rasterise
    from streamlod.core.render.raster import Probe, Raster

__all__ = ["Backend", "Probe", "Raster", "rasterise", "select"]

_LAZY = {
    "Probe": "streamlod.core.render.raster",
    "Raster": "streamlod.core.render.raster",
    "rasterise": "streamlod.core.render.differentiable",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LAZY[name]), name)
