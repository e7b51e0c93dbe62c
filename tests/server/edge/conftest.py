"""A clip that is long enough to lose an origin in."""

from __future__ import annotations

import pytest

from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import write_sound
from tests.clicks import clicks
from tests.server.conftest import Clip, make_clip


@pytest.fixture(scope="session")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """Eight seconds at 50 frames a second, a keyframe each second, with a second of sound."""
    clip = make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 400, key_every=50)
    write_sound(sound_beside(clip.path), [clicks(1.0)], 1, 20_000_000)
    return clip


@pytest.fixture(scope="session")
def slow_long_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """The same in 24 seconds, for tests that must not see it begin again."""
    folder = tmp_path_factory.mktemp("clip")
    return make_clip(folder / "slow.slod", 400, key_every=50, frame_ns=60_000_000)
