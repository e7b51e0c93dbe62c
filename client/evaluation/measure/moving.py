"""Quality on what moves: people watch it, and the mean over a picture hardly notices it.

On synthetic clips the moving pixels are known exactly: the surfaces seen there move. On real video they are those that
change from one picture to the next. Both are dilated, so that edges and what was just uncovered count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from streamlod.client.evaluation.measure.scores import Metric
from streamlod.core.arrays import Bool, Int64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.metrics import Distance, psnr, ssim_map
from streamlod.core.synthetic import SyntheticSpec, moving_surface

MOVING_METRICS = (
    Metric("moving_psnr", "moving PSNR dB", 2),
    Metric("moving_ssim", "moving SSIM", 4),
    Metric("moving_lpips", "moving LPIPS", 4),
)
MIN_PIXELS = 64  # a camera that sees less moving than this says nothing
_REACH = 160  # masks are dilated by the picture's width over this: 3 pixels of 480
_MIN_CHANGE = 6.0  # grey values of 255 that count as change where the noise is lower
_NOISE = 6.0  # standard deviations of the noise that do not
_MIN_BOX = 64  # pixels: side of the smallest box that LPIPS is measured on


@dataclass(frozen=True, slots=True)
class MovingScore:
    """Quality on moving pixels, means over the held-out cameras that see some.

    Attributes:
        share: of the pixels that move.
        psnr, ssim: over these pixels.
        lpips: of the box round them, the still pixels in it replaced by the truth; None where not measured.
    """

    share: float
    psnr: float
    ssim: float
    lpips: float | None = None


class MovingPixels:
    """Which pixels move in the held-out pictures of a clip, asked for frame by frame in order.

    Args:
        cameras: C held-out cameras. spec: of a synthetic clip; None for real video.
    """

    def __init__(self, cameras: Sequence[Camera], spec: SyntheticSpec | None) -> None:
        self._cameras, self._spec = tuple(cameras), spec
        self._before: UInt8 | None = None

    def masks(self, index: int, truth: UInt8) -> Bool | None:
        """[C,H,W] bool for frame `index`, whose pictures are `truth` [C,H,W,3]; None for the first of a real video."""
        before, self._before = self._before, truth
        if self._spec is not None:
            found = [moving_surface(self._spec, index, camera) for camera in self._cameras]
        elif before is None:
            return None
        else:
            found = [_changed(*pair) for pair in zip(before, truth, strict=True)]
        return np.stack([_dilated(mask) for mask in found])


def moving_score(
    drawn: Sequence[UInt8], truth: UInt8, masks: Bool | None, distance: Distance | None = None
) -> MovingScore | None:
    """Scores of C pictures `drawn` against `truth` [C,H,W,3] where `masks` [C,H,W] says; None where nothing moves.

    Args:
        distance: LPIPS, called with two pictures; None to leave it out.
    """
    if masks is None:
        return None
    rows = [
        _row(picture, true, mask, distance)
        for picture, true, mask in zip(drawn, truth, masks, strict=True)
        if mask.sum() >= MIN_PIXELS
    ]
    if not rows:
        return None
    psnrs, ssims, lpips = (np.array(values, float) for values in zip(*rows, strict=True))
    known = lpips[np.isfinite(lpips)]
    perceived = float(known.mean()) if len(known) else None
    return MovingScore(float(masks.mean()), float(psnrs.mean()), float(ssims.mean()), perceived)


def mean_moving(scores: Sequence[MovingScore | None]) -> MovingScore | None:
    """Mean over the frames in which something moves; None where nothing does."""
    known = [score for score in scores if score is not None]
    if not known:
        return None
    lpips = [score.lpips for score in known if score.lpips is not None]
    share, quality, similar = np.mean([(score.share, score.psnr, score.ssim) for score in known], axis=0)
    return MovingScore(float(share), float(quality), float(similar), float(np.mean(lpips)) if lpips else None)


def moving_figures(score: MovingScore | None) -> dict[str, float | None]:
    """A score as entries of a report."""
    names = ("share", "psnr", "ssim", "lpips")
    return {f"moving_{name}": None if score is None else getattr(score, name) for name in names}


def _row(picture: UInt8, truth: UInt8, mask: Bool, distance: Distance | None) -> tuple[float, float, float]:
    similar = float(ssim_map(picture, truth)[mask].mean())
    quality = psnr(picture[mask][None], truth[mask][None])
    if distance is None or min(mask.shape) < _MIN_BOX:
        return quality, similar, np.nan
    rows, columns = (_grown(np.flatnonzero(mask.any(axis=axis)), mask.shape[1 - axis]) for axis in (1, 0))
    shown = np.where(mask[..., None], picture, truth)
    return quality, similar, float(distance(shown[rows, columns], truth[rows, columns]))


def _grown(places: Int64, size: int) -> slice:
    """The range from the first to the last of `places`, grown to at least the smallest box, inside `size`."""
    start, stop = int(places[0]), int(places[-1]) + 1
    missing = max(min(_MIN_BOX, size) - (stop - start), 0)
    start = min(max(start - missing // 2, 0), max(size - (stop - start) - missing, 0))
    return slice(start, max(stop, start + min(_MIN_BOX, size)))


def _changed(before: UInt8, now: UInt8) -> Bool:
    """[H,W] where two pictures in a row differ by more than their noise."""
    smooth = [cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0) for picture in (before, now)]
    difference = np.abs(smooth[1] - smooth[0]).max(axis=2)
    noise = 1.4826 * float(np.median(difference))
    mask = (difference > max(_MIN_CHANGE, _NOISE * noise)).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0)


def _dilated(mask: Bool) -> Bool:
    reach = max(round(mask.shape[1] / _REACH), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc) > 0)
