"""Anchors without which the pictures would be better: found as by leaving each out, and removed one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.camera import look_at, pinhole
from streamlod.core.render.differentiable import rasterise
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.residual.harmful import error_without, judged
from tests.core.train.fields import random_field
from tests.core.true_points import true_points

WIDTH, HEIGHT = 48, 32
CAMERAS = tuple(
    pinhole(f"cam{i}", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT),
            look_at(np.array([x, -0.4, -3.0]), np.zeros(3), np.array([0.0, -1.0, 0.0])))
    for i, x in enumerate((-0.6, 0.0, 0.6))
)  # fmt: skip


def draw(number: int, splats: Splats) -> Tensor:
    return rasterise(*splats.astuple(), CAMERAS[number], torch.zeros(3)).image


def test_the_estimate_is_what_leaving_each_out_gives() -> None:
    field = random_field(40)
    with torch.no_grad():
        splats = field.decode(torch.zeros(3))
    generator = torch.Generator().manual_seed(1)
    pictures = torch.stack([draw(number, splats) for number in range(3)])
    targets = (pictures + 0.2 * torch.rand(pictures.shape, generator=generator)).clamp(0, 1)
    numbers, slots = range(3), field.slots

    def squared(without: int | None) -> float:
        opacities = splats.opacities.clone()
        if without is not None:
            opacities[without * slots : (without + 1) * slots] = 0
        shown = [draw(number, replace(splats, opacities=opacities)) for number in numbers]
        return float(sum((image - targets[i]).square().sum() for i, image in enumerate(shown)))

    whole = squared(None)
    wanted = np.array([squared(anchor) - whole for anchor in range(len(field))])
    estimates = [error_without(lambda _: splats, draw, targets, numbers, len(field), seed) for seed in range(0, 900, 3)]
    found = torch.stack(estimates).mean(dim=0).numpy()
    visible = np.abs(wanted) > 0.05 * np.abs(wanted).max()
    assert visible.sum() > 10
    # what is left is the chance of 300 estimates, and Gaussians of one anchor that hide each other
    assert np.corrcoef(found[visible], wanted[visible])[0, 1] > 0.97
    assert (np.sign(found[visible]) == np.sign(wanted[visible])).mean() > 0.95


def test_a_speck_before_the_scene_is_harmful_and_the_scene_is_not() -> None:
    field = random_field(60)
    with torch.no_grad():
        splats = field.decode(torch.zeros(3))
    slots = field.slots
    speck = slice(7 * slots, 8 * slots)
    clean = splats.opacities.clone()
    clean[speck] = 0
    targets = torch.stack([draw(number, replace(splats, opacities=clean)) for number in range(3)])
    means, opacities, colours = splats.means.clone(), splats.opacities.clone(), splats.colours.clone()
    means[speck], opacities[speck], colours[speck] = torch.tensor([0.0, 0.0, -1.5]), 0.9, 1.0
    spoilt = replace(splats, means=means, opacities=opacities, colours=colours)
    change = error_without(lambda _: spoilt, draw, targets, range(3), len(field), 0).numpy()
    assert change.argmin() == 7
    assert change[7] < -0.1


def test_one_of_each_neighbourhood_goes_and_only_after_some_frames_in_a_row() -> None:
    change = np.array([-1.0, -3.0, -2.0, -5.0, 1.0], np.float32)
    position = np.array([[0.1, 0, 0], [0.2, 0, 0], [3, 0, 0], [9, 0, 0], [12, 0, 0]], np.float32)
    far = np.array([True, True, True, False, True])
    first = judged(change, np.zeros(5, np.int64), far, position, 1.0, 2, 5)
    assert first.frames.tolist() == [1, 1, 1, 1, 0]
    assert not first.gone.any()
    second = judged(change, first.frames, far, position, 1.0, 2, 5)
    assert second.frames.tolist() == [2, 2, 2, 2, 0]
    assert second.gone.tolist() == [False, True, True, False, False]
    assert judged(change, first.frames, far, position, 1.0, 2, 1).gone.tolist() == [False, True, False, False, False]
    better = judged(-change, second.frames, far, position, 1.0, 2, 5)
    assert better.frames.tolist() == [0, 0, 0, 0, 1]
    assert not better.gone.any()


def test_later_frames_of_a_fast_scene_remove_them() -> None:
    spec = SyntheticSpec(kind="hard", cameras=4, frames=6, width=96, height=54, speed=6.0)
    clip = open_synthetic(spec)
    frames = list(clip.frames())
    live = preset("live")
    base = replace(
        live,
        model=replace(live.model, max_anchors=2500),
        keyframe=replace(live.keyframe, steps=100, growth_interval=20),
        predict=replace(live.predict, epochs=4, minimum_steps=16, rewritten_share=0.0),
    )
    first = Trainer(clip.cameras, base, clip.fps, "cpu").keyframe(frames[0], true_points(spec, views=4)).scene
    removed = []
    for least, pixels in ((0, 2.0), (2, 2.0), (2, 1e3)):
        config = replace(base, predict=replace(base.predict, harmful_frames=least, harmful_pixels=pixels))
        trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
        trainer.resume(first)
        residuals = [trainer.predict(frame).residual for frame in frames[1:]]
        removed.append([sum(len(level.removed) for level in residual.levels) for residual in residuals if residual])
    assert removed[1][0] == removed[0][0]  # nobody goes after one frame
    assert sum(removed[1]) > sum(removed[0])
    assert removed[2] == removed[0]  # nobody has gone so far
