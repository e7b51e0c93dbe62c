"""Effects of anchors against pictures drawn without them, and first frames that do without what shows nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.frames import PointCloud
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.render.differentiable import rasterise
from streamlod.core.scene.expand import anchor_positions, expand
from streamlod.core.train import Trainer, preset
from streamlod.core.train.keyframe.effect import anchor_effects, dispensable
from tests.core.train.keyframe.test_first_frame import frames, printed_wall, ring, short, wall

ANCHORS, SLOTS = 12, 2


def test_an_effect_is_what_a_picture_without_the_anchor_shows() -> None:
    """Also of anchors before and behind one another, and of those that nobody sees."""
    generator, cameras = np.random.default_rng(0), ring(2)
    count = ANCHORS * SLOTS
    means = torch.from_numpy(generator.normal(0, 0.5, (count, 3)).astype(np.float32))
    means[:SLOTS, 2] = -40.0  # behind the cameras
    colours = torch.from_numpy(generator.uniform(0, 1, (count, 3)).astype(np.float32))
    rest = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1), torch.full((count, 3), 0.2)
    opacities = torch.from_numpy(generator.uniform(0.2, 0.95, count).astype(np.float32))

    def draw(view: int, shares: tuple[Tensor, ...]) -> Tensor:
        shown = opacities * shares[0].repeat_interleave(SLOTS)
        return rasterise(means, *rest, shown, colours, cameras[view], torch.zeros(3)).image

    whole = [draw(view, (torch.ones(ANCHORS),)) for view in (0, 1)]
    exact = torch.zeros(ANCHORS)
    for anchor in range(ANCHORS):
        present = torch.ones(ANCHORS)
        present[anchor] = 0
        exact[anchor] = sum(float((draw(view, (present,)) - whole[view]).square().sum()) for view in (0, 1)) / 2
    trials = [anchor_effects(ANCHORS, draw, [0, 1], seed, torch.device("cpu")) for seed in range(12)]
    found = torch.stack(trials).mean(dim=0)
    assert float(exact[1:].max() / exact[1:].min()) > 5  # there is something to tell apart
    torch.testing.assert_close(found, exact, rtol=0.35, atol=1e-4)
    assert found[0] == 0


def test_those_of_least_effect_go_while_the_budget_lasts() -> None:
    """Not while the sum of what each one adds lasts: these hide one another, and add four times as much together."""
    effects = torch.tensor([4.0, 0.0, 1.0, 2.0, 0.5])

    def added(present: Tensor) -> float:
        return 4 * float((effects * (1 - present)).sum())

    assert dispensable(effects, 6.0, added).tolist() == [False, True, True, False, True]
    assert dispensable(effects, 5.9, added).tolist() == [False, True, False, False, True]
    assert dispensable(effects, 0.0, added).tolist() == [False, True, False, False, False]


@pytest.mark.parametrize("effects", [torch.zeros(3), torch.ones(1), torch.zeros(0)])
def test_never_all_of_them_go(effects: Tensor) -> None:
    gone = dispensable(effects, 1.0, lambda present: 0.0)
    assert int(gone.sum()) == max(len(effects) - 1, 0)


def left_behind(
    cameras: tuple[Camera, ...], pictures: UInt8, points: PointCloud, share: float, seed: int
) -> tuple[int, float]:
    """Anchors behind the wall after a short training with this `effect_share`, and dB at the cameras."""
    config = replace(short(preset("live"), 200), seed=seed)
    config = replace(config, keyframe=replace(config.keyframe, effect_share=share))
    scene = Trainer(cameras, config, 30.0, "cpu").keyframe(frames(pictures), points).scene
    shown = [render(expand(scene, c.centre), c, np.zeros(3, np.float32)).image.clip(0, 1) for c in cameras]
    quality = np.mean([psnr(a, b.astype(np.float32) / 255) for a, b in zip(shown, pictures, strict=True)])
    depth = [anchor_positions(scene.header, number, level)[:, 2] for number, level in enumerate(scene.levels)]
    return int((np.concatenate(depth) > 0.75).sum()), float(quality)


@pytest.mark.slow
def test_anchors_that_a_wall_hides_are_not_sent() -> None:
    cameras = ring(3)
    pictures, visible, hidden = printed_wall(cameras, 1.2), wall(300), wall(300, seed=1)
    behind = hidden.positions + np.array([0, 0, 1.5], np.float32)
    points = PointCloud(np.concatenate([visible.positions, behind]), np.concatenate([visible.colours, hidden.colours]))
    found = []
    for share in (0.0, preset("live").keyframe.effect_share):
        counts, quality = zip(*(left_behind(cameras, pictures, points, share, seed) for seed in (0, 1)), strict=True)
        found.append((sum(counts), float(np.mean(quality))))
    (all_of_them, before), (fewer, after) = found
    assert fewer < 0.5 * all_of_them
    assert after > before - 1.0
