"""A clip that is long enough to lose an origin in."""

from __future__ import annotations

import pytest

from tests.server.conftest import Clip, make_clip


@pytest.fixture(scope="session")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Eight seconds at 50 frames a second, a keyframe each second."""
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 400, key_every=50)


@pytest.fixture(scope="session")
def slow_long_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """The same in 24 seconds, for tests that must not see it begin again."""
    folder = tmp_path_factory.mktemp("clip")
    return make_clip(folder / "slow.slod", 400, key_every=50, frame_ns=60_000_000)
