"""How fast a camera films, from when its pictures come."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from streamlod.server.ingest.sync.pace import Pace, is_slow

MS = 1_000_000


def rate(*times_ms: float) -> float | None:
    """The rate of a camera whose pictures came at these times."""
    pace = Pace()
    for ms in times_ms:
        pace.note(round(ms * MS))
    return pace.rate


def filmed(begin_ms: float, fps: float, seconds: float) -> Iterable[float]:
    """Times of pictures."""
    return (begin_ms + 1000 * number / fps for number in range(round(seconds * fps) + 1))


@pytest.mark.parametrize("away_ms", [100, 1_500, 60_000])
def test_a_silence_makes_no_camera_slow(away_ms: float) -> None:
    assert rate(*filmed(0, 10, 2), *filmed(2000 + away_ms, 10, 2)) == pytest.approx(10)


@pytest.mark.parametrize(("before", "after"), [(100, 2), (2, 100)])
def test_a_camera_is_judged_by_its_last_seconds(before: float, after: float) -> None:
    assert rate(*filmed(0, before, 20), *filmed(20_000, after, 5.1)) == pytest.approx(after, rel=0.01)


def test_a_camera_that_hardly_filmed_is_not_judged() -> None:
    assert rate() is None
    assert rate(0) is None, "one picture has no pace"
    assert rate(0, 900, 1800, 9000, 9690) is None
    assert rate(0, 900, 1800, 9000, 9700) == pytest.approx(1.2)
    assert not is_slow(None, 30)


def test_a_flood_of_pictures_takes_no_memory_and_is_not_slow() -> None:
    found = rate(*filmed(0, 1000, 6))
    assert found is None or not is_slow(found, 120)
