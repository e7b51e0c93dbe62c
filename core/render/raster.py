"""The result of rasterising for training."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


class Probe:
    """Which Gaussians were visible, and how the loss pulls at them in the picture: what growth and motion tests ask.

    Args:
        visible: [V] int64 ascending rows of the Gaussians in view.
        wanted: [V] bool, those that the probe is about; all by default. Looked at when somebody asks, since picking
            rows on a GPU makes the host wait for their number.
    """

    def __init__(self, visible: Tensor, wanted: Tensor | None = None) -> None:
        self._visible, self._wanted = visible, wanted
        self._gradients: Tensor | None = None
        self._scale: Tensor | None = None

    @property
    def visible(self) -> Tensor:
        """[M] int64 ascending rows of the Gaussians in view (of the first `gradient_rows`, where that was given)."""
        return self._picked(self._visible)

    @property
    def gradients(self) -> Tensor:
        """[M,2] float32 dL/d(projected mean) of `visible`, times half the width and height.

        The scaling makes thresholds independent of the picture's size: a unit is half a picture.

        Raises:
            RuntimeError: the loss has not been differentiated yet.
        """
        if self._gradients is None:
            raise RuntimeError("a probe has gradients only after backward() of a loss on its picture")
        return self._scaled(self._gradients)

    def record(self, gradients: Tensor, scale: Tensor | None = None) -> None:
        """For backends: put down [V,2] gradients after a backward pass, and the [2] factors still to be applied."""
        self._gradients, self._scale = gradients, scale

    def _picked(self, values: Tensor) -> Tensor:
        return values if self._wanted is None else values[self._wanted]

    def _scaled(self, values: Tensor) -> Tensor:
        return self._picked(values if self._scale is None else values * self._scale)


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """A differentiable picture.

    Attributes:
        image: [H,W,3] float32 RGB over the background.
        transmittance: [H,W] float32 in [0, 1], what of the background shows; differentiable too.
        probe: visibility and view-space gradients.
    """

    image: Tensor
    transmittance: Tensor
    probe: Probe
