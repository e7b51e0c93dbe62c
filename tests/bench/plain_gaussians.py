"""Plain 3D Gaussian splatting on our rasteriser and loss: the contender that the anchor model is measured against.

Kerbl et al. 2023 with its usual rates, doubled for runs of a few thousand steps (which helps it), degree-0 colour,
clone and split by view-space gradient, prune by opacity. Training stops by CPU seconds, so that both get equal time.
"""

from __future__ import annotations

import math
import time

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from core.frames import PointCloud
from core.render.differentiable import rasterise
from core.render.raster import Raster
from core.train.optimise.adam import RowAdam
from core.train.optimise.losses import photometric_loss
from core.train.optimise.schedule import ViewOrder
from core.train.pictures.views import Views

_INTERVAL, _FROM, _UNTIL, _PRUNE, _FIRST_OPACITY = 100, 0.05, 0.65, 0.01, 0.5
_RATES = {"means": 1.6e-3, "scales": 0.01, "quaternions": 0.002, "opacities": 0.05, "colours": 0.005 * 0.2821}


class PlainGaussians:
    """Trains one instant; `extent` is the radius of the camera rig in world units."""

    def __init__(self, points: PointCloud, views: Views, *, threshold: float = 4e-4, seed: int = 0) -> None:
        self._views, self._threshold = views, threshold
        self._generator = torch.Generator().manual_seed(seed)
        self._order = ViewOrder(views.usable, self._generator)
        centres = np.stack([camera.centre for camera in views.cameras])
        self._extent = 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
        count = len(points)
        distance, _ = cKDTree(points.positions).query(points.positions, k=4)
        scale = np.sqrt((distance[:, 1:] ** 2).mean(axis=1)).clip(1e-4).astype(np.float32)
        start = {
            "means": torch.from_numpy(points.positions.copy()),
            "scales": torch.from_numpy(np.log(scale))[:, None].repeat(1, 3),
            "quaternions": torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
            "opacities": torch.full((count,), math.log(_FIRST_OPACITY / (1 - _FIRST_OPACITY))),
            "colours": torch.from_numpy(points.colours.copy()),
        }
        self._optimiser = RowAdam({name: value.requires_grad_() for name, value in start.items()})
        self._pull, self._seen = torch.zeros(count), torch.zeros(count)

    def __len__(self) -> int:
        return len(self._pull)

    def train(self, cpu_seconds: float) -> int:
        """Train for so many CPU seconds; returns the steps taken."""
        begin, steps = time.process_time(), 0
        while (progress := (time.process_time() - begin) / cpu_seconds) < 1:
            number = self._order.next()
            raster = self.render(number)
            loss = photometric_loss(raster.image, self._views.targets[number])
            loss.backward()
            decay = {"means": self._extent * 0.01**progress}
            self._optimiser.step({name: rate * decay.get(name, 1.0) for name, rate in _RATES.items()})
            self._pull.index_add_(0, raster.probe.visible, raster.probe.gradients.norm(dim=1))
            self._seen.index_add_(0, raster.probe.visible, torch.ones(len(raster.probe.visible)))
            steps += 1
            if steps % _INTERVAL == 0 and _FROM < progress < _UNTIL:
                self._densify()
        return steps

    def render(self, number: int | None = None, camera: object = None) -> Raster:
        """The picture of training camera `number`, or of any `camera`."""
        p = self._optimiser.parameters
        return rasterise(
            p["means"],
            p["quaternions"],
            p["scales"].exp(),
            p["opacities"].sigmoid(),
            p["colours"].clamp_min(0),
            self._views.cameras[number] if number is not None else camera,  # type: ignore[arg-type]
            torch.zeros(3),
        )

    def _densify(self) -> None:
        p = {name: value.detach() for name, value in self._optimiser.parameters.items()}
        hot = self._pull / self._seen.clamp_min(1) > self._threshold
        big = p["scales"].exp().max(dim=1).values > 0.01 * self._extent
        clones, splits = torch.nonzero(hot & ~big)[:, 0], torch.nonzero(hot & big)[:, 0].repeat(2)
        kept = torch.nonzero((p["opacities"].sigmoid() > _PRUNE) & ~(hot & big))[:, 0]
        new: dict[str, Tensor] = {name: torch.cat([value[clones], value[splits]]) for name, value in p.items()}
        spread = torch.randn(len(splits), 3, generator=self._generator) * p["scales"][splits].exp()
        new["means"][len(clones) :] += spread
        new["scales"][len(clones) :] -= math.log(1.6)
        self._optimiser.replace_rows(kept, new)
        count = len(self._optimiser.parameters["means"])
        self._pull, self._seen = torch.zeros(count), torch.zeros(count)
