"""The closed loop under pictures, states and rates that nobody hopes for: always finite, always the decoder's state."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.arrays import UInt8
from streamlod.core.data import Dataset
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, TrainConfig, TrainedFrame, Trainer, preset
from streamlod.core.train.presets.settings import with_settings
from tests.codec.scenes import assert_same_state
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=4, frames=12, width=96, height=54, fps=10.0)
CAMERA = 2  # the one that things happen to


def config(**changed: float | str) -> TrainConfig:
    """Preset live with hardly any steps."""
    live = preset("live")
    keyframe = replace(live.keyframe, steps=80, growth_interval=20)
    predict = replace(live.predict, epochs=2, minimum_steps=8)
    model = replace(live.model, max_anchors=2500)
    return TrainConfig(model, keyframe, replace(predict, **changed), live.parts)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def clip() -> Dataset:
    return open_synthetic(SPEC)


@pytest.fixture(scope="module")
def images(clip: Dataset) -> list[UInt8]:
    """Pictures of the first frames."""
    return [frame.images for frame in clip.frames(0, 4)]


@pytest.fixture(scope="module")
def first(clip: Dataset, images: list[UInt8]) -> Scene:
    frame = frame_set(0, images[0])
    return Trainer(clip.cameras, config(), clip.fps, "cpu").keyframe(frame, true_points(SPEC)).scene


def frame_set(index: int, images: UInt8, present: Iterable[bool] | None = None) -> FrameSet:
    flags = np.ones(len(images), np.bool_) if present is None else np.array(list(present))
    return FrameSet(index, index, images, flags)


def loop(trainer: Trainer, scene: Scene, pictures: Iterable[UInt8]) -> list[TrainedFrame]:
    """Resume `scene`, train on `pictures`, and hold a decoder fed with the packets against it, bit for bit."""
    decoder, results = SceneDecoder(), list[TrainedFrame]()
    decoder.push(encode_keyframe(scene, time_ns=0))
    trainer.resume(scene)
    for index, picture in enumerate(pictures, start=scene.version + 1):
        before, result = trainer.scene, trainer.predict(frame_set(index, picture))
        assert result.residual is not None
        decoder.push(encode_residual(before, result.residual, time_ns=index))
        assert_same_state(result.scene, decoder.scene)
        assert np.isfinite(result.report.loss)
        results.append(result)
    cloud = expand(results[-1].scene, scene.header.cameras[0].centre)
    assert all(np.isfinite(getattr(cloud, name)).all() for name in ("means", "scales", "opacities", "colours"))
    return results


def quality(scene: Scene, clip: Dataset, images: UInt8, number: int = 0) -> float:
    camera = clip.cameras[number]
    shown = render(expand(scene, camera.centre), camera, scene.header.background).image.clip(0, 1)
    return psnr(shown, images[number].astype(np.float32) / 255)


def black(picture: UInt8) -> UInt8:
    return np.zeros_like(picture)


def white(picture: UInt8) -> UInt8:
    return np.full_like(picture, 255)


def noise(picture: UInt8) -> UInt8:
    return np.random.default_rng(0).integers(0, 256, picture.shape, np.uint8)


def flash(picture: UInt8) -> UInt8:
    return (picture.astype(np.int64) * 2 + 40).clip(0, 255).astype(np.uint8)


def covered(picture: UInt8) -> UInt8:
    dark = picture.copy()
    dark[CAMERA] = 0
    return dark


def swapped(picture: UInt8) -> UInt8:
    order = np.arange(len(picture))
    order[[CAMERA, 0]] = 0, CAMERA
    return picture[order]


@pytest.mark.long
@pytest.mark.parametrize(
    ("spoil", "frames"), [(black, 1), (white, 1), (noise, 1), (flash, 1), (covered, 10), (swapped, 2)]
)
def test_a_scene_comes_back_after_bad_pictures(
    clip: Dataset, images: list[UInt8], first: Scene, spoil: Callable[[UInt8], UInt8], frames: int
) -> None:
    trainer = Trainer(clip.cameras, config(), clip.fps, "cpu")
    still = images[0]
    results = loop(trainer, first, [still, *[spoil(still)] * frames, *[still] * 6])
    begun, spoilt, ended = (quality(results[place].scene, clip, still) for place in (0, frames, -1))
    assert ended > min(begun - 3, spoilt + 3)  # a few frames of a few steps do not heal everything


@pytest.mark.long
def test_a_change_is_trained_until_that_helps_no_more(clip: Dataset, images: list[UInt8], first: Scene) -> None:
    """Not for one frame only; and a scene that stands still costs nothing in the end, however wrong it is shown."""
    gains = []
    (later,) = (frame.images for frame in clip.frames(8, 9))
    for seed in range(3):  # runs of eight steps a frame differ
        steady = config(most_effort=1.0)  # or the first frame alone would do most of it
        trainer = Trainer(clip.cameras, replace(steady, seed=seed), clip.fps, "cpu")
        results = loop(trainer, first, [images[0], *[later] * 12])
        trained = [result.report.dynamic for result in results]
        assert min(trained[1:4]) > 0
        assert trained[-1] == 0
        gains.append(quality(results[-1].scene, clip, later) - quality(results[1].scene, clip, later))
        for number in range(len(clip.cameras)):  # what one camera still lacks is not mended at the expense of others
            early, late = (quality(results[index].scene, clip, later, number) for index in (3, -1))
            assert late > early - 0.6
    assert np.mean(gains) > 0.4


@pytest.mark.parametrize("factor", [100.0, 1e-3])
def test_rates_far_off_stay_finite(clip: Dataset, images: list[UInt8], first: Scene, factor: float) -> None:
    predict = PredictConfig()
    wild = config(**{name: getattr(predict, name) * factor for name in ("latent_rate", "position_rate")})
    loop(Trainer(clip.cameras, wild, clip.fps, "cpu"), first, images[1:4])


@pytest.mark.parametrize("end", [1, -1])
def test_states_at_the_end_of_their_integers_saturate(
    clip: Dataset, images: list[UInt8], first: Scene, end: int
) -> None:
    """Latents and positions that can go no farther in one direction; anchors of every third row, far out of sight."""

    def edge(level: AnchorLevel) -> AnchorLevel:
        latent, position = level.latent.copy(), level.position.copy()
        latent[::2] = np.iinfo(np.int16).max if end > 0 else np.iinfo(np.int16).min
        position[::3] = np.iinfo(np.int32).max if end > 0 else np.iinfo(np.int32).min
        return replace(level, latent=latent, position=position)

    far = replace(first, levels=tuple(edge(level) for level in first.levels), version=1)
    wild = with_settings(config(latent_rate=50.0, position_rate=500.0, cue="everything"), {"new_anchors.share": 0})
    trainer = Trainer(clip.cameras, wild, clip.fps, "cpu")
    trainer.resume(far)
    for index, picture in enumerate(images[1:4], start=2):
        scene = trainer.predict(frame_set(index, picture)).scene
    for before, after in zip(far.levels, scene.levels, strict=True):
        assert after.latent.dtype == np.int16
        assert len(before) == len(after)
    pairs = list(zip(far.levels, scene.levels, strict=True))
    assert any((after.latent != before.latent).any() for before, after in pairs)
    assert as_keyframe(scene, scene.version).anchor_count == scene.anchor_count


def test_two_views_and_fifty_points_make_a_first_frame(clip: Dataset, images: list[UInt8]) -> None:
    frame = frame_set(0, images[0][:2])
    found = true_points(SPEC, views=2)
    chosen = np.linspace(0, len(found.positions) - 1, 50).astype(int)
    few = PointCloud(found.positions[chosen], found.colours[chosen])
    trainer = Trainer(clip.cameras[:2], config(), clip.fps, "cpu")
    scene = trainer.keyframe(frame, few).scene
    assert scene.anchor_count > 0
    results = loop(Trainer(clip.cameras[:2], config(), clip.fps, "cpu"), scene, [images[1][:2], images[2][:2]])
    assert np.isfinite(quality(results[-1].scene, clip, images[2]))


def test_everything_that_changes_and_nothing_that_does(clip: Dataset, images: list[UInt8], first: Scene) -> None:
    trainer = Trainer(clip.cameras, config(), clip.fps, "cpu")
    still, moving = images[0], 255 - images[0]
    results = loop(trainer, first, [still, still, moving])
    quiet, loud = results[1], results[2]
    assert (quiet.report.dynamic, quiet.report.steps) == (0, 0)
    assert loud.report.dynamic > loud.report.anchors / 2


def test_a_new_keyframe_changes_nothing_for_training(clip: Dataset, images: list[UInt8], first: Scene) -> None:
    """Rekeying in the middle: what was known stays known, so a still frame after it stays empty."""
    trainer = Trainer(clip.cameras, config(), clip.fps, "cpu")
    results = loop(trainer, first, [images[0], *[images[1]] * 12])
    assert results[-1].report.steps == 0  # training of the change has come to its end
    trainer.resume(as_keyframe(trainer.scene, trainer.scene.version), keep_references=True)
    assert trainer.predict(frame_set(14, images[1])).report.steps == 0


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_thousand_frames_do_not_drift() -> None:
    """A small picture to and fro, each round 22 frames: about two minutes."""
    spec = replace(SPEC, cameras=3, width=48, height=27)
    clip = open_synthetic(spec)
    pictures = [frame.images for frame in clip.frames()]
    small = config(epochs=1, minimum_steps=4)
    small = replace(small, model=replace(small.model, max_anchors=600))
    trainer = Trainer(clip.cameras, small, clip.fps, "cpu")
    scene = trainer.keyframe(frame_set(0, pictures[0]), true_points(spec)).scene
    there_and_back = [*pictures[1:], *pictures[-2::-1]]
    results = loop(trainer, scene, (there_and_back[index % len(there_and_back)] for index in range(1000)))
    rounds = [
        np.mean(
            [quality(result.scene, clip, there_and_back[n]) for n, result in enumerate(results[begin : begin + 22])]
        )
        for begin in (22, 968)
    ]
    assert rounds[1] > rounds[0] - 0.5
    assert np.mean([result.report.steps > 0 for result in results]) > 0.9
