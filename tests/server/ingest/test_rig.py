"""What a rig counts of the instants that it gives to training."""

from __future__ import annotations

import time

import numpy as np
import pytest

from streamlod.server.ingest.cameras.definition import read_definition
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.statistics import SLOW
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant
from streamlod.server.ingest.sync.timeline import Timeline
from tests.server.ingest.push.stage import FPS, rig
from tests.waiting import wait


def _picture(camera: str, capture_ns: int) -> Picture:
    return Picture(camera, capture_ns, ClockSource.STATED, 0, lambda: np.zeros((8, 8, 3), np.uint8))


@pytest.mark.parametrize("missing", [False, True])
def test_latency_counts_from_the_oldest_picture_not_from_the_place_on_the_grid(missing: bool) -> None:
    """A place on the grid may lie half a period after the pictures: a picture sent at once had no latency."""
    taken_ns = time.time_ns() - 20_000_000
    pictures = (_picture("phone1", taken_ns), None if missing else _picture("phone2", taken_ns + 10_000_000))
    watched = Rig(read_definition(rig((64, 48), 2)), ("phone1", "phone2"))
    latency_ns = watched.note_delivery(Instant(0, taken_ns + 3_600_000_000_000, pictures))
    assert 20_000_000 <= latency_ns < 10_000_000_000
    assert watched.statistics().latency_ns == latency_ns


@pytest.mark.parametrize(
    ("later_ns", "said"),
    [(None, "its times stand still: "), (90_000_000_000, "its times are far from those of the other cameras: ")],
)
def test_who_films_is_told_that_the_times_of_its_camera_are_wrong(later_ns: int | None, said: str) -> None:
    names, begin_ns = ("phone1", "phone2", "phone3"), time.time_ns()
    watched = Rig(read_definition(rig((64, 48), 3)), names)

    def complaint() -> str:
        now = time.time_ns()
        watched.put(_picture("phone2", begin_ns if later_ns is None else now + later_ns))
        for name in ("phone1", "phone3"):
            watched.put(_picture(name, now))
        return watched.complaint("phone2")

    assert wait(complaint, 60) == f"{said}reload this page; until then its pictures are left out"
    assert watched.complaint("phone1") == ""
    troubles = {name: one.trouble.partition(":")[0] for name, one in watched.statistics().cameras.items()}
    assert troubles == {"phone1": "", "phone2": said.partition(":")[0], "phone3": ""}


def test_cameras_that_do_not_film_as_they_should_say_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second is slow, the third was knocked, two have each other's names, the last never came."""
    names, begin_ns = tuple(f"phone{number}" for number in range(1, 7)), time.time_ns()
    watched = Rig(read_definition(rig((64, 48), len(names))), names)
    for number in range(3 * FPS):
        now = begin_ns + number * 1_000_000_000 // FPS
        monkeypatch.setattr(Timeline, "now_ns", lambda _, now=now: now)
        for name in names[:-1]:
            if name != "phone2" or number % 2 == 0:
                watched.put(_picture(name, now))
    watched.findings.note_shifts([0.0, 0.0, 9.0, 0.0, 0.0, None], np.arange(6) == 2)
    exchanged = "phone4 and phone5 are exchanged: swap their names"
    watched.findings.note_poses((exchanged,))
    cameras = watched.statistics().cameras
    assert {name: one.trouble for name, one in cameras.items()} == {
        "phone1": "",
        "phone2": SLOW.format(10, FPS),
        "phone3": "it was knocked: put it back as it stood, or calibrate again",
        "phone4": exchanged,
        "phone5": exchanged,
        "phone6": "no pictures come",
    }
    assert cameras["phone1"].rate == pytest.approx(FPS)
