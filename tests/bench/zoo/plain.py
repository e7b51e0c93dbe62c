"""Plain 3D Gaussian splatting on our rasteriser and loss: the contender that the anchor model is measured against.

The model and its gradients are those of Kerbl et al. 2023 with degree-0 colour: free Gaussians, cloned and split by
view-space gradient, pruned by opacity. What surrounds them is as good as we could make it (docs/history/zoo.md has what
was tried), so that a lead over it means something: thinned first points, pictures of half the size to begin with,
fitted exposures, the mean of the last steps. Training stops by CPU seconds, so that both get equal time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from streamlod.core.arrays import Float32, UInt8
from streamlod.core.camera import Camera
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.render.differentiable import rasterise
from streamlod.core.render.raster import Raster
from streamlod.core.scene.expand import near_radius
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.keyframe.random_background import over_colour
from streamlod.core.train.loss.photometric import photometric_loss
from streamlod.core.train.optimise.adam import RowAdam
from streamlod.core.train.optimise.schedule import view_order
from streamlod.core.train.pictures.views import Views

_COLOUR_RATE = 0.0025 * 2.0
_SHRINK = math.log(1.6)  # of the two halves of a split Gaussian


@dataclass(frozen=True, slots=True)
class PlainConfig:
    """Choices of the training; fractions are of the run, rates are Adam's per step.

    Attributes:
        cell_pixels: first points are thinned to one in a cell of so many pixels as the nearest camera sees it; 0 keeps
            all.
        opacity: of the first Gaussians.
        means_rate: in radii of the camera rig, decaying to `final_rate` of itself.
        threshold: of the view-space gradient norm, from which a Gaussian is cloned or split.
        big: in radii of the rig, from which it is split rather than cloned.
        densify_interval: in steps; densify_until: no more after it.
        prune: opacity below which a Gaussian goes.
        opacity_weight: weight in the loss of the mean opacity.
        random_background: draw every step over another colour where pictures are not black (docs/history/zoo.md).
        half_size_until: pictures of half the width and height up to here.
        average_from: the result is the mean over the steps from here on.
        exposure_rate: of a gain and an offset a channel for each training camera; 0 fits none.
    """

    cell_pixels: float = 8.0
    opacity: float = 0.5
    means_rate: float = 1.6e-3
    final_rate: float = 0.01
    scales_rate: float = 0.01
    quaternions_rate: float = 0.002
    opacities_rate: float = 0.05
    colours_rate: float = _COLOUR_RATE
    threshold: float = 4e-4
    big: float = 0.01
    densify_interval: int = 100
    densify_from: float = 0.05
    densify_until: float = 0.65
    prune: float = 0.01
    opacity_weight: float = 0.02
    random_background: bool = False
    half_size_until: float = 0.2
    average_from: float = 0.8
    exposure_rate: float = 0.002


def thinned(points: PointCloud, cameras: tuple[Camera, ...], pixels: float) -> PointCloud:
    """The mean of the points in each cell of a grid; cells double in size with distance.

    Args:
        pixels: width of a cell as the nearest of the `cameras` sees it, at most; at least half of that.
    """
    if pixels <= 0:
        return points
    positions = points.positions.astype(np.float64)
    footprint = np.min(
        [np.linalg.norm(positions - camera.centre, axis=1) / camera.intrinsics[0, 0] for camera in cameras], axis=0
    )
    size = 2.0 ** np.floor(np.log2(np.maximum(pixels * footprint, 1e-12)))
    cells = np.concatenate([np.log2(size)[:, None], np.floor(positions / size[:, None])], axis=1)
    _, inverse, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)

    def mean(values: Float32) -> Float32:
        sums = np.zeros((len(counts), 3))
        np.add.at(sums, inverse.ravel(), values)
        return (sums / counts[:, None]).astype(np.float32)

    return PointCloud(mean(points.positions), mean(points.colours))


class PlainGaussians:
    """Trains one instant from first points, for so many seconds of `clock`: by default this process's CPU time."""

    def __init__(
        self,
        points: PointCloud,
        views: Views,
        config: PlainConfig | None = None,
        *,
        seed: int = 0,
        clock: Callable[[], float] = time.process_time,
    ) -> None:
        self._config, self._clock = config or PlainConfig(), clock
        config = self._config
        self._whole, self._views = views, views.halved() if config.half_size_until > 0 else views
        self._generator = torch.Generator().manual_seed(seed)
        self._order = view_order(views.usable, self._generator)
        centres = np.stack([camera.centre for camera in views.cameras])
        self._extent = 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
        points = thinned(points, views.cameras, config.cell_pixels)
        count = len(points)
        distance, _ = cKDTree(points.positions).query(points.positions, k=min(4, count))
        scale = np.sqrt((distance[:, 1:] ** 2).mean(axis=1)).clip(1e-6 * self._extent).astype(np.float32)
        start = {
            "means": torch.from_numpy(points.positions.copy()),
            "scales": torch.from_numpy(np.log(scale))[:, None].repeat(1, 3),
            "quaternions": torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
            "opacities": torch.full((count,), math.log(config.opacity / (1 - config.opacity))),
            "colours": torch.from_numpy(points.colours.copy()),
        }
        self._rows = tuple(start)
        self._exposure = neutral(len(views.cameras))
        if config.exposure_rate:
            start |= {"gain": self._exposure.gain, "offset": self._exposure.offset}
        self._optimiser = RowAdam({name: value.requires_grad_() for name, value in start.items()})
        self._pull, self._seen = torch.zeros(count), torch.zeros(count)

    def __len__(self) -> int:
        return len(self._pull)

    def train(self, seconds: float) -> int:
        """Train for so many seconds; returns the steps taken."""
        begin, steps, config = self._clock(), 0, self._config
        while (progress := (self._clock() - begin) / seconds) < 1:
            if progress >= config.half_size_until:
                self._views = self._whole
            self._step(progress)
            steps += 1
            if progress >= config.average_from:
                self._optimiser.average()
            if steps % config.densify_interval == 0 and config.densify_from < progress < config.densify_until:
                self._densify()
        return steps

    def follow(self, views: Views, seconds: float) -> None:
        """Train on the pictures of the next instant for so many seconds; no Gaussian comes or goes."""
        mean, self._optimiser.mean = self._optimiser.mean, {}
        for name in self._rows if mean else ():
            self._optimiser.parameters[name].data.copy_(mean[name])
        self._whole = self._views = views
        begin = self._clock()
        while (progress := (self._clock() - begin) / max(seconds, 1e-9)) < 1:
            self._step(0.5 + 0.5 * progress)

    @torch.no_grad()
    def picture(self, camera: Camera) -> UInt8:
        """[H,W,3] what `camera` sees of the result, by the rule of `core.scene.expand.without_near`."""
        parameters = self._optimiser.mean or self._optimiser.parameters
        away = parameters["means"] - torch.from_numpy(camera.centre).float()
        kept = away.norm(dim=1) >= near_radius(self._whole.cameras, camera.centre)
        image = self._render({name: parameters[name][kept] for name in self._rows}, camera, torch.zeros(3)).image
        return np.asarray((image.numpy() * 255).round().clip(0, 255), np.uint8)

    @torch.no_grad()
    def cloud(self) -> GaussianCloud:
        """The result as a file of Gaussians has it."""
        found = {name: (self._optimiser.mean or self._optimiser.parameters)[name].numpy() for name in self._rows}
        return GaussianCloud(
            means=found["means"],
            quaternions=found["quaternions"],
            scales=np.exp(found["scales"]),
            opacities=1 / (1 + np.exp(-found["opacities"])),
            colours=found["colours"].clip(0),
        )

    def _step(self, progress: float) -> None:
        config, number, parameters = self._config, next(self._order), self._optimiser.parameters
        raster = self._render(parameters, self._views.cameras[number], torch.zeros(3))
        image = raster.image
        if config.random_background:
            colour = torch.rand(3, generator=self._generator)
            image = over_colour(image, raster.transmittance, self._views.targets[number], colour)
        if config.exposure_rate:
            image = self._exposure.apply(image, number)
        loss = photometric_loss(image, self._views.targets[number])
        if config.opacity_weight:
            loss = loss + config.opacity_weight * parameters["opacities"].sigmoid().mean()
        loss.backward()  # type: ignore[no-untyped-call]
        slow = config.final_rate**progress
        self._optimiser.step(
            {
                "means": config.means_rate * self._extent * slow,
                "scales": config.scales_rate,
                "quaternions": config.quaternions_rate,
                "opacities": config.opacities_rate,
                "colours": config.colours_rate * 0.2821,
                "gain": config.exposure_rate * slow,
                "offset": config.exposure_rate * slow,
            }
        )
        if config.exposure_rate:
            self._exposure.centre()
        self._pull.index_add_(0, raster.probe.visible, raster.probe.gradients.norm(dim=1))
        self._seen.index_add_(0, raster.probe.visible, torch.ones(len(raster.probe.visible)))

    def _render(self, parameters: dict[str, Tensor], camera: Camera, background: Tensor) -> Raster:
        return rasterise(
            parameters["means"],
            parameters["quaternions"],
            parameters["scales"].exp(),
            parameters["opacities"].sigmoid(),
            parameters["colours"].clamp_min(0),
            camera,
            background,
        )

    def _densify(self) -> None:
        config, parameters = self._config, self._optimiser.parameters
        p = {name: parameters[name].detach() for name in self._rows}
        hot = self._pull / self._seen.clamp_min(1) > config.threshold
        big = p["scales"].exp().max(dim=1).values > config.big * self._extent
        clones, splits = torch.nonzero(hot & ~big)[:, 0], torch.nonzero(hot & big)[:, 0].repeat(2)
        kept = torch.nonzero((p["opacities"].sigmoid() > config.prune) & ~(hot & big))[:, 0]
        new: dict[str, Tensor] = {name: torch.cat([value[clones], value[splits]]) for name, value in p.items()}
        spread = torch.randn(len(splits), 3, generator=self._generator) * p["scales"][splits].exp()
        new["means"][len(clones) :] += spread
        new["scales"][len(clones) :] -= _SHRINK
        self._optimiser.replace_rows(kept, new)
        count = len(self._optimiser.parameters["means"])
        self._pull, self._seen = torch.zeros(count), torch.zeros(count)


def plain_views(frame: FrameSet, cameras: tuple[Camera, ...]) -> Views:
    """The pictures of one instant as `PlainGaussians` wants them."""
    usable = np.flatnonzero(frame.present).tolist()
    return Views(cameras, torch.from_numpy(frame.images).float() / 255, usable)
