"""Finds what moves: pixels first, then anchors (paper section IV-B; docs/method.md, readings 16 to 18).

Pixels: each camera's picture is compared with its *reference*: what was filmed when a change was last accepted there,
or what the model shows where training of that goes on. Only changes above the camera's own noise count, so a still
scene yields nothing at all, whatever the model's static error; and as a reference is renewed only where a change was
accepted, slow drift adds up until it is seen.

Anchors: scores of motion from `core.train.motion.scores`, split in two by a Gaussian mixture on their fourth root.
(On the logarithm, as one might read the paper, the mixture's wide low component swallows the top: see docs/method.md.)
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.train.pictures.parallel import map_pictures
from streamlod.core.train.pictures.views import Views

_BLUR = (5, 5)  # pixels; averages the noise, keeps edges of moving things
_FOLDED = 0.6745  # median of the absolute value of a normal variable, in standard deviations
_NOISE_FACTOR = 5.0  # standard deviations of the blurred difference
_MAX_FLOOR = 4.0  # floors; no camera worth using is noisier after the blur
_SEED_FACTOR = 1.6  # a region of change needs a seed this much above the threshold
_MIN_REGION = 12  # pixels
_GROW = 5  # pixels that a region is widened by: the blur and the object's edge
_MIN_SCORED = 16  # below so many scored anchors a mixture means nothing
_POWER = 0.25


def changed_pixels(reference: Float32, current: Float32, threshold: float) -> Bool:
    """[H,W] where `current` differs from `reference` (both [H,W,3] float32 in [0, 1]) by more than `threshold`."""
    difference = _largest_difference(current, reference)
    weak = (difference > threshold).astype(np.uint8)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(weak, connectivity=8)
    strongest = np.zeros(count, np.float32)
    np.maximum.at(strongest, labels.ravel().astype(np.int64), difference.ravel())
    accepted = (strongest > _SEED_FACTOR * threshold) & (statistics[:, cv2.CC_STAT_AREA] >= _MIN_REGION)
    accepted[0] = False
    mask = accepted[labels].astype(np.uint8)
    return np.asarray(cv2.dilate(mask, np.ones((_GROW, _GROW), np.uint8)) > 0)


def _largest_difference(one: Float32, other: Float32) -> Float32:
    """[H,W] largest over the channels of the difference of two blurred pictures."""
    red, green, blue = cv2.split(np.abs(cv2.blur(one, _BLUR) - cv2.blur(other, _BLUR)))
    return np.asarray(np.maximum(np.maximum(red, green), blue))  # four times as fast as a reduction of a short axis


def noise_between(before: Tensor, now: Tensor) -> Tensor:
    """[C] noise of each camera, in units of [0, 1], from its pictures of two successive frames [C,H,W,3].

    It is the standard deviation of the difference of means over 5x5 pixels. Most of a picture stands still from one
    frame to the next, so that it follows from their median. Reference pictures are older: shade and exposure have
    drifted since. NaN for a camera whose picture is NaN.
    """
    averages = functional.avg_pool2d((now - before).permute(0, 3, 1, 2), _BLUR, ceil_mode=True)
    return averages.abs().amax(dim=1).flatten(1).median(dim=1).values / _FOLDED


def change_masks(references: Tensor, before: Tensor, views: Views, floor: float) -> Tensor:
    """[C,H,W] bool: pixels of each usable camera that changed against `references` [C,H,W,3].

    Args:
        before: [C,H,W,3] pictures of the frame before, which tell how noisy cameras are.
        floor: smallest change that counts, in units of [0, 1].
    """
    masks = torch.zeros(references.shape[:3], dtype=torch.bool, device=references.device)
    noise = noise_between(before, views.targets).tolist()
    rows = [
        (references[number].cpu().numpy(), views.targets[number].cpu().numpy(), least_change(noise[number], floor))
        for number in views.usable
    ]
    changed = map_pictures(changed_pixels, rows)
    for number, mask in zip(views.usable, changed, strict=True):
        masks[number] = torch.from_numpy(mask).to(references.device)
    return masks


def least_change(noise: float, floor: float) -> float:
    """Difference of blurred pictures that counts, at least `floor`: well above the camera's `noise`."""
    # where most of the picture changes, in a flash, the median is no noise, hence the limit
    return min(max(floor, _NOISE_FACTOR * noise), _MAX_FLOOR * floor)


def mixture_threshold(scores: Float64, posterior: float) -> float:
    """Score from which an anchor is dynamic with at least this posterior, by a mixture of two Gaussians (paper eq. 8).

    Made monotone: everything above the lowest score from which the posterior stays above the threshold is dynamic.

    Args:
        scores: [N] positive, finite.

    Returns:
        The threshold; 0 where there are too few scores or they are all alike, so that all are dynamic.
    """
    if len(scores) < _MIN_SCORED:
        return 0.0
    limited = np.minimum(scores, 10 * np.quantile(scores, 0.98))  # one wild score must not bend the mixture
    values = (limited / limited.mean()) ** _POWER
    if np.ptp(values) < 1e-6:
        return 0.0
    from sklearn.mixture import GaussianMixture  # loads for a second, which first frames need not wait for

    mixture = GaussianMixture(
        2,
        means_init=np.quantile(values, [0.25, 0.98])[:, None],
        weights_init=[0.9, 0.1],
        reg_covar=2.5e-3,
        random_state=0,
    ).fit(values[:, None])
    high = int(np.argmax(mixture.means_[:, 0]))
    order = np.argsort(values)
    probability = mixture.predict_proba(values[order, None])[:, high]
    unsure = np.flatnonzero((probability <= posterior) | (values[order] <= mixture.means_[1 - high, 0]))
    first = unsure[-1] + 1 if len(unsure) else 0
    return float(scores[order[first]]) if first < len(order) else float("inf")


def dynamic_anchors(scores: Float64, posterior: float) -> Bool:
    """[N] anchors to train: those whose score is above the mixture's threshold.

    Args:
        scores: [N] motion scores, 0 for anchors that see no change.
        posterior: of the mixture's dynamic component, from which an anchor is dynamic.
    """
    scores = np.nan_to_num(scores, nan=0.0, posinf=0.0, neginf=0.0)
    scored = scores > 0
    if not scored.any():
        return np.zeros(len(scores), np.bool_)
    return scored & (scores >= mixture_threshold(scores[scored], posterior))
