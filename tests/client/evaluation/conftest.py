"""A tiny synthetic clip on disk, its footage, and configurations that train within a second."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.client.evaluation.measure.footage import Footage, open_footage
from streamlod.core.data import linspace_split
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.completion import completed
from streamlod.core.initialise.views import working_views
from streamlod.core.synthetic import SyntheticSpec, write_clip
from streamlod.core.train import TrainConfig

SPEC = SyntheticSpec(cameras=4, frames=3, width=96, height=54)


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clip") / "room"
    write_clip(SPEC, folder)
    return folder


@pytest.fixture(scope="session")
def footage(clip: Path) -> Footage:
    names = tuple(f"cam{number:02d}" for number in range(SPEC.cameras))
    return open_footage(clip, linspace_split(names, 2, names[:1]), frames=None, downscale=1)


@pytest.fixture(scope="session")
def many_points(footage: Footage) -> PointCloud:
    """First points everywhere, as two small pictures match in few places."""
    first, _ = next(footage.pairs())
    return completed(footage.points, working_views(first, footage.training.cameras, 45))


def shortened(config: TrainConfig) -> TrainConfig:
    """`config` with hardly any steps."""
    keyframe = replace(config.keyframe, steps=12, growth_interval=5)
    return replace(config, keyframe=keyframe, predict=replace(config.predict, epochs=1, minimum_steps=4))
