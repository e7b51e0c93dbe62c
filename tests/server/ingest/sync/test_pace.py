"""How fast a camera films, from when its pictures come."""

from __future__ import annotations

import pytest

from streamlod.server.ingest.sync.pace import Pace

MS = 1_000_000


def filmed(pace: Pace, *times_ms: float) -> Pace:
    """The pace with pictures that came at these times."""
    for ms in times_ms:
        pace = pace.then(round(ms * MS))
    return pace


@pytest.mark.parametrize("away_ms", [0, 1_500, 60_000])
def test_a_silence_makes_no_camera_slow(away_ms: float) -> None:
    before = filmed(Pace(), 0, 100, 200)
    after = filmed(before, *(300 + away_ms + 100 * number for number in range(10)))
    assert after.since(before, 0.9) == pytest.approx(10)


def test_a_slow_camera_is_slow_however_it_was_before() -> None:
    before = filmed(Pace(), *range(0, 1000, 10))
    assert filmed(before, *range(1490, 4000, 500)).since(before, 2.0) == pytest.approx(2)


def test_a_camera_that_hardly_filmed_is_not_judged() -> None:
    assert Pace().since(Pace(), 1.0) is None
    assert filmed(Pace(), 0).since(Pace(), 1.0) is None, "one picture has no pace"
    assert filmed(Pace(), 0, 900, 3000, 3090).since(Pace(), 1.0) is None
    assert filmed(Pace(), 0, 900, 3000, 3100).since(Pace(), 1.0) == pytest.approx(2)
