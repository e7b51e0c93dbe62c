"""The whole trainer on a small synthetic clip: it learns, follows motion, stays still, and never drifts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.camera import Camera
from streamlod.core.data import Dataset
from streamlod.core.errors import ModelError
from streamlod.core.frames import FrameSet
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, TrainedFrame, Trainer, preset
from tests.codec.scenes import assert_same_state
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=5, frames=4, width=64, height=36, seed=1)
BLACK = np.zeros(3, np.float32)


def small_config() -> TrainConfig:
    config = preset("live")
    return replace(
        config,
        model=replace(config.model, features=16),
        keyframe=replace(config.keyframe, steps=100, growth_interval=25),
        predict=replace(config.predict, epochs=4, minimum_steps=20),
    )


@pytest.fixture(scope="module")
def clip() -> Dataset:
    return open_synthetic(SPEC)


@pytest.fixture(scope="module")
def frames(clip: Dataset) -> list[FrameSet]:
    return list(clip.frames())


def train(clip: Dataset, frames: list[FrameSet]) -> Iterator[TrainedFrame]:
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    yield trainer.keyframe(frames[0], true_points(SPEC))
    for frame in frames[1:]:
        yield trainer.predict(frame)


@pytest.fixture(scope="module")
def trained(clip: Dataset, frames: list[FrameSet]) -> list[TrainedFrame]:
    return list(train(clip, frames))


def quality(scene: Scene, camera: Camera, picture: np.ndarray) -> float:
    image = render(expand(scene, camera.centre), camera, BLACK).image
    return psnr(image.clip(0, 1), picture.astype(np.float32) / 255)


def test_the_first_frame_is_learnt(clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]) -> None:
    scores = [quality(trained[0].scene, c, i) for c, i in zip(clip.cameras, frames[0].images, strict=True)]
    assert np.mean(scores) > 22


def test_later_frames_follow_what_moves(clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]) -> None:
    last = frames[-1]
    followed = np.mean([quality(trained[-1].scene, c, i) for c, i in zip(clip.cameras, last.images, strict=True)])
    frozen = np.mean([quality(trained[0].scene, c, i) for c, i in zip(clip.cameras, last.images, strict=True)])
    assert followed > frozen + 1
    for result in trained[1:]:
        assert 0 < result.report.dynamic < 0.5 * result.report.anchors


def test_the_decoder_holds_the_trainers_state_bit_for_bit(trained: list[TrainedFrame]) -> None:
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(trained[0].scene, time_ns=0))
    for before, result in pairwise(trained):
        assert result.residual is not None
        decoder.push(encode_residual(before.scene, result.residual, time_ns=0))
        assert_same_state(result.scene, decoder.scene)


@pytest.mark.long
def test_the_same_seed_gives_the_same_scene(clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]) -> None:
    again = list(train(clip, frames[:3]))
    for mine, theirs in zip(again[1:], trained[1:], strict=False):
        assert [level.digest() for level in mine.scene.levels] == [level.digest() for level in theirs.scene.levels]


def test_nothing_moves_nothing_is_sent(clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]) -> None:
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[0].scene)
    trainer.predict(replace_index(frames[0], 1))  # sets what the state was last shown
    noise = np.random.default_rng(0).normal(0, 1.0, frames[0].images.shape)
    noisy = (frames[0].images + noise).round().clip(0, 255).astype(np.uint8)
    before = trainer.scene
    result = trainer.predict(FrameSet(2, 2, noisy, frames[0].present))
    assert result.report.dynamic == 0
    assert result.residual is not None
    packet = encode_residual(before, result.residual, time_ns=0)
    assert len(packet) <= 64


def test_a_change_is_trained_until_that_helps_no_more(
    clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]
) -> None:
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[0].scene)
    trainer.predict(replace_index(frames[0], 1))
    later = [trainer.predict(replace_index(frames[1], index)).report.steps for index in range(2, 14)]
    assert later[0] > 0
    assert later[-1] == 0


def test_a_resumed_trainer_goes_on(clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]) -> None:
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[1].scene)
    result = trainer.predict(frames[3])
    camera, picture = clip.cameras[0], frames[3].images[0]
    assert quality(result.scene, camera, picture) > quality(trained[1].scene, camera, picture)


def test_cameras_that_are_missing_are_not_trained_on(
    clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]
) -> None:
    present = np.array([True, False, True, True, True])
    images = frames[1].images.copy()
    images[1] = 255  # must not be looked at
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[0].scene)
    result = trainer.predict(FrameSet(1, 1, images, present))
    assert quality(result.scene, clip.cameras[1], frames[1].images[1]) > 20
    with pytest.raises(ModelError, match="no picture"):
        trainer.predict(FrameSet(2, 2, images, np.zeros(5, np.bool_)))


def test_a_camera_that_joins_late_is_no_motion(
    clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame]
) -> None:
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[0].scene)
    absent = np.array([True, True, True, True, False])
    blank = frames[0].images.copy()
    blank[4] = 0
    trainer.predict(FrameSet(1, 1, blank, absent))
    trainer.predict(FrameSet(2, 2, frames[0].images, frames[0].present))  # joins: shown to the model for the first time
    result = trainer.predict(FrameSet(3, 3, frames[0].images, frames[0].present))
    assert result.report.dynamic == 0


@pytest.mark.parametrize("value", [0, 255, "noise"])
def test_extreme_pictures_leave_the_state_finite(
    clip: Dataset, frames: list[FrameSet], trained: list[TrainedFrame], value: int | str
) -> None:
    random = np.random.default_rng(3)
    images = (
        random.integers(0, 256, frames[0].images.shape, np.uint8)
        if value == "noise"
        else np.full_like(frames[0].images, value)
    )
    trainer = Trainer(clip.cameras, small_config(), clip.fps, "cpu")
    trainer.resume(trained[0].scene)
    result = trainer.predict(FrameSet(1, 1, images, frames[0].present))
    cloud = expand(result.scene, clip.cameras[0].centre)
    assert all(np.isfinite(getattr(cloud, name)).all() for name in ("means", "scales", "opacities", "colours"))


def test_prediction_needs_a_state(clip: Dataset, frames: list[FrameSet]) -> None:
    with pytest.raises(ModelError, match="keyframe"):
        Trainer(clip.cameras, small_config(), clip.fps, "cpu").predict(frames[0])


def replace_index(frame: FrameSet, index: int) -> FrameSet:
    return FrameSet(index, index, frame.images, frame.present)
