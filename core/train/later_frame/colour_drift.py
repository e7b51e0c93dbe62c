"""Cameras whose exposure or white balance drifts while live: their pictures, as they showed things before.

Each picture is compared with the camera's reference picture. A gain and an offset that most of its pixels agree on, and
that the other cameras do not share, are the camera's; what most cameras share is light, and the scene's own.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.train.field.exposure import Exposure, neutral
from streamlod.core.train.pictures.clipping import CLIPPED
from streamlod.core.train.pictures.views import Views, halved_pictures

_APART = 4  # pixels between those that are looked at; four make a cell
_SAME = 0.02  # difference of cells that show the same
_DARK = 0.1  # cells below say little about a gain
_MOST, _LEAST = 0.5, 0.1  # of the cells that are not clipped, and of all of them, that must agree
_FLAT = 1e-3  # variance of cells below which a picture says nothing of gain and offset apart
_MAX_GAIN, _MAX_OFFSET = 2.0, 0.25  # farther away, a picture is left as it is filmed
_SEEN = 0.02  # a smaller change counts as none, as of what moves (`PredictConfig.noise_floor`)


def followed(drift: Exposure, views: Views, references: Tensor, known: list[int]) -> Exposure:
    """How far each camera has drifted by now, gains and offsets, from `drift` by which it had until the frame before.

    Args:
        references: [C,H,W,3] pictures without drift. known: cameras that have one, and a picture.
    """
    if not known:
        return drift
    device, drift = drift.gain.device, Exposure(drift.gain.cpu(), drift.offset.cpu())  # so that a GPU is asked once
    since = neutral(len(views.cameras))
    cells = _cells(views.targets).cpu(), _cells(references).cpu()
    for number in known:
        now, then = (each[number] for each in cells)
        until = (now - drift.offset[number]) / drift.gain[number]
        darkest, brightest = torch.minimum(now, then), torch.maximum(now, then)
        whole = (darkest > CLIPPED) & (brightest < 1 - CLIPPED)
        for channel in range(3):
            some = whole[:, channel]
            agreed = _agreed(then[some, channel], until[some, channel], _LEAST * len(whole))
            since.gain[number, channel], since.offset[number, channel] = agreed
    after = since.then(drift)
    # what cameras share is light
    gain = after.gain / after.gain[known].quantile(0.5, dim=0)
    offset = after.offset - after.offset[known].quantile(0.5, dim=0)
    fits = ((gain / _MAX_GAIN < 1) & (gain * _MAX_GAIN > 1) & (offset.abs() < _MAX_OFFSET)).all(dim=1)
    told = torch.tensor([number in known for number in range(len(gain))])
    chosen = (fits & told)[:, None]
    gain, offset = torch.where(chosen, gain, drift.gain), torch.where(chosen, offset, drift.offset)
    return Exposure(gain.to(device), offset.to(device))


def without_drift(views: Views, drift: Exposure, references: Tensor) -> Views:
    """`views` with the pictures of cameras that have drifted as they would be without.

    Args:
        references: [C,H,W,3] pictures without drift, taken where a picture is clipped that it says would be; NaN where
            none is known.
    """
    far = torch.maximum((drift.gain + drift.offset - 1).abs(), drift.offset.abs()).amax(dim=1)
    drifted = [number for number in torch.nonzero(far > _SEEN)[:, 0].tolist() if number in views.usable]
    if not drifted:
        return views
    targets = views.targets.clone()
    for number in drifted:
        gain, offset, filmed = drift.gain[number], drift.offset[number], targets[number]
        before = references[number]
        expected = torch.addcmul(offset, before, gain)
        clipped = ((filmed >= 1 - CLIPPED) & (expected >= 1 - CLIPPED)) | ((filmed <= CLIPPED) & (expected <= CLIPPED))
        targets[number] = torch.where(clipped, before, ((filmed - offset) / gain).clamp(0, 1))
    return replace(views, targets=targets)


def _cells(pictures: Tensor) -> Tensor:
    """[C,P,3] means of a few pixels of each small square of `pictures` [C,H,W,3]."""
    return halved_pictures(pictures[:, ::_APART, ::_APART]).flatten(1, 2)


def _agreed(before: Tensor, now: Tensor, least: float) -> tuple[float, float]:
    """Gain and offset that take most of `before` [P], and `least` of them, to `now` [P]; none where these disagree."""
    bright = before > _DARK
    if not bright.any():
        return 1.0, 0.0
    gain, offset = float((now[bright] / before[bright]).median()), 0.0
    for _ in range(2):
        same = (now - gain * before - offset).abs() < _SAME
        if int(same.sum()) < max(_MOST * len(before), least):
            return 1.0, 0.0
        x, y = before[same].double(), now[same].double()
        spread = x - x.mean()
        variance = float(spread.square().mean())
        if variance > _FLAT:
            gain = float((spread * y).mean()) / variance
        offset = float(y.mean()) - gain * float(x.mean())
    return gain, offset
