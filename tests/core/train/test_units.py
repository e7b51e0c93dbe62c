"""Neither the unit of a calibration nor its origin or axes change what is trained, to the last bit of the states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from streamlod.core.camera.space import Similarity
from streamlod.core.data.dataset import Dataset
from streamlod.core.initialise import first_points
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from tests.client.evaluation.conftest import shortened

SPEC = SyntheticSpec(kind="room", cameras=4, frames=2, width=96, height=54)
TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()


def trained(recording: Dataset) -> list[int]:
    """Digests of the levels of two frames, trained briefly in the space of training."""
    dataset = recording.normalised()
    trainer = Trainer(dataset.cameras, shortened(preset("live")), dataset.fps, "cpu")
    first, second = dataset.frames(0, 2)
    key = trainer.keyframe(first, first_points(first, dataset.cameras, depth_bounds=dataset.depth_bounds)).scene
    later = trainer.predict(second).scene
    assert later.anchor_count > 100
    return [level.digest() for level in (*key.levels, *later.levels)]


def moved(dataset: Dataset, change: Similarity) -> Dataset:
    """The same recording, calibrated in other coordinates."""
    recording = dataset.recording
    assert recording.depth_bounds is not None
    cameras = tuple(change.camera(camera) for camera in recording.cameras)
    recording = replace(recording, cameras=cameras, depth_bounds=change.depths(recording.depth_bounds))
    plans = tuple(replace(plan, camera=change.camera(plan.camera)) for plan in dataset.developments)
    return replace(dataset, recording=recording, developments=plans)


@pytest.fixture(scope="module")
def usual() -> list[int]:
    return trained(open_synthetic(SPEC))


@pytest.mark.long
@pytest.mark.parametrize(("scale", "origin"), [(1e-3, (3.0, -4.0, 100.0)), (1e3, (5e5, -3e5, 120.0))])
def test_other_units_places_and_axes_give_the_same_states(
    usual: list[int], scale: float, origin: tuple[float, float, float]
) -> None:
    assert trained(moved(open_synthetic(SPEC), Similarity(scale, TURN, np.array(origin)))) == usual
