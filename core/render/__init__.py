"""Rendering: one set of rules, three backends.

* `core.render.cpu`: numba kernels; its forward pass needs numpy and numba only, so that a client can use it.
* `core.render.cuda`: gsplat.
* `core.render.reference`: dense float64 torch, slow and obvious: the oracle of the other two.

`core.render.differentiable.rasterise` is the training interface over all three. The rules (`docs/numerics.md`) are
gsplat's: low-pass 0.3 pixels^2, alpha in [1/255, 0.999], a pixel ends when its transmittance would fall to 1e-4.
Nothing heavy is imported here.
"""

from core.render.backends import Backend, select

__all__ = ["Backend", "select"]
