"""Neither the unit of a calibration nor its origin or axes change what is trained.

As far as numbers of 64 bits hold the calibration, the states agree to the last bit. Ten million units from the origin
they hold less of it; quality and bytes then agree as those of two trainings do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.camera.space import Similarity
from streamlod.core.data.dataset import Dataset
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from tests.client.evaluation.conftest import shortened

SPEC = SyntheticSpec(kind="room", cameras=4, frames=2, width=64, height=36)
TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()


@dataclass(frozen=True)
class Trained:
    """Two frames, trained briefly.

    Attributes:
        digests: of the levels of both.
        decibels: PSNR of both, over all cameras.
        sizes: bytes of the keyframe and of the change to the second frame.
    """

    digests: list[int]
    decibels: list[float]
    sizes: list[int]


def trained(recording: Dataset) -> Trained:
    """Both frames of `recording`, trained in the space of training."""
    dataset = recording.normalised()
    trainer = Trainer(dataset.cameras, shortened(preset("live")), dataset.fps, "cpu")
    first, second = dataset.frames(0, 2)
    key = trainer.keyframe(first, first_points(first, dataset.cameras, depth_bounds=dataset.depth_bounds)).scene
    residual = trainer.predict(second)
    later = residual.scene
    assert later.anchor_count > 100
    return Trained(
        [level.digest() for level in (*key.levels, *later.levels)],
        [_quality(key, first), _quality(later, second)],
        [len(encode_keyframe(key, time_ns=0)), len(encode_residual(key, residual.residual, time_ns=1))],
    )


def _quality(scene: Scene, frame: FrameSet) -> float:
    """PSNR of all cameras' pictures together."""
    shown = [render(expand(scene, c.centre), c, scene.header.background).image.clip(0, 1) for c in scene.header.cameras]
    return psnr(np.concatenate(shown), np.concatenate(list(frame.images / np.float32(255))))


def moved(dataset: Dataset, change: Similarity) -> Dataset:
    """The same recording, calibrated in other coordinates."""
    recording = dataset.recording
    assert recording.depth_bounds is not None
    cameras = tuple(change.camera(camera) for camera in recording.cameras)
    recording = replace(recording, cameras=cameras, depth_bounds=change.depths(recording.depth_bounds))
    plans = tuple(replace(plan, upright=change.camera(plan.upright)) for plan in dataset.undistortions)
    return replace(dataset, recording=recording, undistortions=plans)


@pytest.fixture(scope="module")
def usual() -> Trained:
    return trained(open_synthetic(SPEC))


@pytest.mark.long
@pytest.mark.parametrize(("scale", "origin"), [(1e-3, (3.0, -4.0, 100.0)), (1e3, (5e5, -3e5, 120.0))])
def test_other_units_places_and_axes_give_the_same_states(
    usual: Trained, scale: float, origin: tuple[float, float, float]
) -> None:
    assert trained(moved(open_synthetic(SPEC), Similarity(scale, TURN, np.array(origin)))) == usual


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_ten_million_units_from_the_origin_quality_and_bytes_are_the_same(usual: Trained, scale: float) -> None:
    found = trained(moved(open_synthetic(SPEC), Similarity(scale, TURN, np.array([1e7, -0.7e7, 0.4e7]))))
    np.testing.assert_allclose(found.decibels, usual.decibels, rtol=0, atol=0.2)
    np.testing.assert_allclose(found.sizes, usual.sizes, rtol=0.03)
