"""Quality where viewers stand: at the cameras that trained, a little beside each, and between neighbours.

A held-out camera says how well a scene is shown from elsewhere. It does not say whether a viewer who stands where a
camera stood sees what that camera filmed, nor what a step to the side costs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from streamlod.client.evaluation.measure.scores import Perception, PictureScore, mean_score, score_picture
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.camera.beside import views_beside
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.synthetic import SyntheticSpec, render_view

BESIDE = (0.05, 0.1, 0.25, 0.5)  # shares of the way from a camera to its nearest neighbour; the last is half way
PLACES = {  # figures of a run by name: place and figure
    "at_psnr": ("at", "psnr"),
    "at_psnr_fitted": ("at", "psnr_fitted"),
    **{f"beside_{share:g}_psnr": (f"{share:g}", "psnr") for share in BESIDE},
}
PLACE_HEADINGS = ("at cameras dB", "exposure fitted", *(f"{share:.0%} aside dB" for share in BESIDE))
_FIGURES = ("psnr", "ssim", "psnr_fitted")
_NO_NETWORKS = Perception()


def places(
    draw: Callable[[Camera], UInt8],
    cameras: Sequence[Camera],
    filmed: UInt8,
    spec: SyntheticSpec | None = None,
    index: int = 0,
    space: Similarity = UNCHANGED,
) -> dict[str, Any]:
    """PSNR, SSIM, and PSNR at the best exposure, by place.

    Args:
        draw: [H,W,3] what a viewer sees who stands at a camera.
        cameras: C that trained; filmed: [C,H,W,3] their pictures.
        spec: of a synthetic clip, of which it is known what is seen beside the cameras; None for a recording.
        index: frame of the clip.
        space: leads from the clip's coordinates to those of the cameras.

    Returns:
        ``at``: the figures of each camera by name; ``beside``: their means over the cameras by share of the way to the
        nearest other camera, as text; empty where nothing is known there.
    """
    at = [score_picture(draw(camera), picture, _NO_NETWORKS) for camera, picture in zip(cameras, filmed, strict=True)]
    beside: dict[str, Any] = {}
    if spec is not None and len(cameras) > 1:
        for share in BESIDE:
            views = views_beside(cameras, share)
            seen = [true_view(spec, index, space.inverse().camera(view)) for view in views]
            scores = [score_picture(draw(view), truth, _NO_NETWORKS) for view, truth in zip(views, seen, strict=True)]
            beside[f"{share:g}"] = _figures(mean_score(scores))
    return {
        "at": {camera.name: _figures(score) for camera, score in zip(cameras, at, strict=True)},
        "beside": beside,
    }


def true_view(spec: SyntheticSpec, index: int, camera: Camera) -> UInt8:
    """[H,W,3] what `camera` sees of a clip, where smaller than the clip's pictures scaled down as those are."""
    factor = np.sqrt(spec.width * spec.height / (camera.width * camera.height))
    size = round(camera.width * factor), round(camera.height * factor)
    if factor <= 1 or size == (camera.width, camera.height):
        return render_view(spec, index, camera)
    whole = render_view(spec, index, camera.scaled(*size))
    return np.asarray(cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def mean_figure(found: dict[str, Any], place: str, figure: str) -> float | None:
    """Mean of a `figure` at all cameras (`place` ``at``), or at a share of the way; None where it was not measured."""
    if place == "at":
        values = [score[figure] for score in found["at"].values()]
        return float(np.mean(values)) if values else None
    scores: dict[str, float] = found["beside"].get(place, {})
    return scores.get(figure)


def mean_places(found: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Findings of `places` in some frames as one: at each camera the mean of its frames, beside them of the first."""
    at = {name: [frame["at"][name] for frame in found if name in frame["at"]] for name in _names(found)}
    return {
        "at": {
            name: {figure: float(np.mean([score[figure] for score in scores])) for figure in _FIGURES}
            for name, scores in at.items()
        },
        "beside": found[0]["beside"] if found else {},
    }


def places_table(found: dict[str, Any]) -> str:
    """One line a place: PSNR as shown, at the best exposure, SSIM."""
    rows = [(f"at {name}", score) for name, score in found["at"].items()]
    rows += [(f"{float(share):.0%} of the way to the next camera", score) for share, score in found["beside"].items()]
    return "\n".join(
        f"  {place:40s}{score['psnr']:.2f} dB, exposure fitted {score['psnr_fitted']:.2f} dB, SSIM {score['ssim']:.4f}"
        for place, score in rows
    )


def _names(found: Sequence[dict[str, Any]]) -> list[str]:
    """Cameras in any of the frames, in the order in which they appear."""
    return list(dict.fromkeys(name for frame in found for name in frame["at"]))


def _figures(score: PictureScore) -> dict[str, float]:
    return {name: getattr(score, name) for name in _FIGURES}
