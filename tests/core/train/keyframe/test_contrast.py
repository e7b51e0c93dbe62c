"""Dark pictures get as fine a model as bright ones, and large pictures a finer one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.pictures.views import Views
from tests.core.train.keyframe.test_first_frame import ring, short
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=4, frames=1, width=64, height=36)


def test_contrast_is_the_mean_deviation_of_usable_pictures_within_a_channel() -> None:
    pictures = torch.rand(3, 32, 48, 3, dtype=torch.float64)
    pictures[1] = 7.0  # not usable
    used = pictures[[0, 2]].numpy()
    expected = np.abs(used - used.mean(axis=(1, 2), keepdims=True)).mean()
    assert Views(ring(3), pictures, [0, 2]).contrast == pytest.approx(expected)
    assert Views(ring(3), torch.full((3, 32, 48, 3), 0.7), [0, 1, 2]).contrast == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_a_dark_scene_keeps_its_detail() -> None:
    clip = open_synthetic(SPEC)
    frame, points = next(iter(clip.frames())), true_points(SPEC)
    dark = np.round(0.25 * frame.images).astype(np.uint8), replace(points, colours=0.25 * points.colours)
    config = short(preset("live"), 120, max_anchors=20_000)
    ignoring = replace(config, keyframe=replace(config.keyframe, usual_contrast=0.0))
    counts = {}
    for name, chosen, images, start in (
        ("bright", config, frame.images, points), ("dark", config, *dark), ("ignored", ignoring, *dark),
    ):  # fmt: skip
        trainer = Trainer(clip.cameras, chosen, 10.0, "cpu")
        counts[name] = trainer.keyframe(replace(frame, images=images), start).scene.anchor_count
    assert counts["dark"] > 0.75 * counts["bright"]
    assert counts["ignored"] < 0.75 * counts["dark"]


def test_larger_pictures_than_usual_get_more_anchors() -> None:
    clip = open_synthetic(SPEC)
    frame, points = next(iter(clip.frames())), true_points(SPEC)
    config = short(preset("live"), 60, max_anchors=20_000)
    counts, own = {}, SPEC.width * SPEC.height
    for pixels in (0, own, own // 16):
        chosen = replace(config, keyframe=replace(config.keyframe, usual_pixels=pixels))
        counts[pixels] = Trainer(clip.cameras, chosen, 10.0, "cpu").keyframe(frame, points).scene.anchor_count
    assert counts[0] == counts[own]
    assert counts[own // 16] > 1.1 * counts[0]
