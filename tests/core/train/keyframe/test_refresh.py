"""A keyframe in mid-stream: better than the state that it replaces, where it moved, and nothing where nothing did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.data import Dataset
from streamlod.core.frames import FrameSet
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.field.convert import field_of, scene_of
from tests.codec.scenes import assert_same_state
from tests.core.train.fields import random_field
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=4, frames=6, width=64, height=36, fps=10.0)


def config() -> TrainConfig:
    """Preset live with few steps, most of them in the keyframe that renews."""
    live = preset("live")
    return replace(
        live,
        model=replace(live.model, max_anchors=2500),
        keyframe=replace(live.keyframe, steps=80, growth_interval=20, refresh_steps=60),
        predict=replace(live.predict, epochs=2, minimum_steps=8),
    )


@pytest.fixture(scope="module")
def clip() -> Dataset:
    return open_synthetic(SPEC)


@pytest.fixture(scope="module")
def frames(clip: Dataset) -> list[FrameSet]:
    return list(clip.frames())


@pytest.fixture(scope="module")
def first(clip: Dataset, frames: list[FrameSet]) -> Scene:
    return Trainer(clip.cameras, config(), clip.fps, "cpu").keyframe(frames[0], true_points(SPEC)).scene


def trainer_at(
    clip: Dataset, first: Scene, pictures: list[FrameSet], budget_ms: float | None = None, **keyframe: float
) -> Trainer:
    """A trainer that has seen `pictures`, with other settings of its keyframes."""
    chosen = replace(config(), keyframe=replace(config().keyframe, **keyframe))  # type: ignore[arg-type]
    trainer = Trainer(clip.cameras, chosen, clip.fps, "cpu", frame_budget_ms=budget_ms)
    trainer.resume(first)
    for frame in pictures:
        trainer.predict(frame)
    return trainer


def quality(scene: Scene, clip: Dataset, frame: FrameSet) -> float:
    """Mean PSNR over the training cameras."""
    pictures = [render(expand(scene, c.centre), c, np.zeros(3, np.float32)).image.clip(0, 1) for c in clip.cameras]
    truths = frame.images.astype(np.float32) / 255
    return float(np.mean([psnr(picture, truth) for picture, truth in zip(pictures, truths, strict=True)]))


@pytest.mark.long
def test_catches_up_and_goes_on(clip: Dataset, frames: list[FrameSet], first: Scene) -> None:
    """It shows its frame better than the state did, and the frames after it lead on from what viewers decode."""
    trainer = trainer_at(clip, first, frames[1:5])
    before = trainer.scene
    renewed = trainer.refresh(frames[4])
    assert renewed.report.steps == 60
    assert (renewed.scene.keyframe, renewed.scene.version) == (before.version, before.version)
    assert quality(renewed.scene, clip, frames[4]) > quality(before, clip, frames[4]) + 0.5
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(renewed.scene, time_ns=0))
    after = trainer.predict(frames[5])
    assert after.residual is not None
    assert after.residual.changed > 0
    decoder.push(encode_residual(renewed.scene, after.residual, time_ns=1))
    assert_same_state(after.scene, decoder.scene)


def test_a_still_scene_trains_nothing(clip: Dataset, frames: list[FrameSet], first: Scene) -> None:
    """What has not changed is sent again as it is, and the still frame after it is empty too."""
    trainer = trainer_at(clip, first, [replace(frames[0], index=1)])  # which trains: it has not seen the cameras yet
    keyframe = as_keyframe(trainer.scene, 1)
    trainer.resume(keyframe, keep_references=True)
    trainer.predict(replace(frames[0], index=2))
    renewed = trainer.refresh(replace(frames[0], index=2))
    assert renewed.report.steps == 0
    assert (renewed.scene.keyframe, renewed.scene.version) == (2, 2)
    for mine, theirs in zip(renewed.scene.levels, keyframe.levels, strict=True):
        np.testing.assert_array_equal(mine.feature, theirs.feature)
    assert trainer.predict(replace(frames[0], index=3)).report.steps == 0


@pytest.mark.long
def test_a_frame_budget_sends_the_state_as_it_is(clip: Dataset, frames: list[FrameSet], first: Scene) -> None:
    """A run would outlast the frame; the frames after it lead on from what is sent."""
    trainer = trainer_at(clip, first, frames[1:4], budget_ms=60_000)
    known = trainer.scene
    renewed = trainer.refresh(frames[3])
    assert renewed.report.steps == 0
    expected = as_keyframe(known, known.version)
    assert [level.digest() for level in renewed.scene.levels] == [level.digest() for level in expected.levels]
    after = trainer.predict(frames[4])
    assert after.residual is not None
    assert after.residual.changed > 0


@pytest.mark.slow
def test_keyframe_after_keyframe_keeps_what_is_hidden_for_now(
    clip: Dataset, frames: list[FrameSet], first: Scene
) -> None:
    """Each of them once took a tenth of the anchors away, and a stream faded from keyframe to keyframe.

    Nor does their number grow without end.
    """
    trainer = trainer_at(clip, first, [])
    for index, frame in enumerate([*frames[1:], *frames[4:1:-1]], 1):
        shown = replace(frame, index=index)
        trainer.predict(shown)
        renewed = trainer.refresh(shown).scene
    assert 0.93 * first.anchor_count < renewed.anchor_count < 1.05 * first.anchor_count


@pytest.mark.parametrize("alive", [0, 1, 3])
def test_a_scene_that_is_nearly_gone(clip: Dataset, frames: list[FrameSet], first: Scene, alive: int) -> None:
    """After a black picture, say: hardly an anchor lives, and none of them need be seen."""
    coarse, *finer = first.levels
    levels = [replace(coarse, alive=np.arange(len(coarse)) < alive)]
    levels += [replace(level, alive=np.zeros(len(level), np.bool_)) for level in finer]
    trainer = Trainer(clip.cameras, config(), clip.fps, "cpu")
    trainer.resume(replace(first, levels=tuple(levels)))
    renewed = trainer.refresh(frames[0]).scene
    assert renewed.anchor_count <= alive
    SceneDecoder().push(encode_keyframe(renewed, time_ns=0))


def test_moved_anchors_stay_where_they_are() -> None:
    """A keyframe's anchors lie on nodes; those of a state have moved, by whole position steps."""
    field = random_field(60)
    scene = scene_of(field, preset("live").predict, (), 30.0, 0)
    rng = np.random.default_rng(0)
    levels = tuple(
        replace(level, position=rng.integers(-300, 300, level.position.shape).astype(np.int32))
        for level in scene.levels
    )
    moved = field_of(replace(scene, levels=levels))
    again = field_of(scene_of(moved, preset("live").predict, (), 30.0, 1))
    torch.testing.assert_close(again.position, moved.position, rtol=0, atol=1e-6)
    assert not torch.equal(again.position, field_of(scene).position)
