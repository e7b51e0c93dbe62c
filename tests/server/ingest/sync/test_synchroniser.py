"""The synchroniser against schedules of arrivals: what it pairs, what it gives up, what it says about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant, Synchroniser
from streamlod.server.ingest.sync.time_fault import TimeFault

MS = 1_000_000
PERIOD = 33_333_333  # 30 fps
HOUR = 3_600_000_000_000
UTC = 1_790_000_000 * 1_000_000_000


def picture(camera: str, capture_ns: int) -> Picture:
    return Picture(camera, capture_ns, ClockSource.NTP, 0, lambda: np.zeros((2, 2, 3), np.uint8))


@dataclass
class Film:
    """Arrivals (time, camera, capture) and what came of them."""

    cameras: tuple[str, ...]
    arrivals: list[tuple[int, str, int]]

    def run(self, **options: int) -> tuple[Synchroniser, list[Instant], int]:
        synchroniser = Synchroniser(self.cameras, 30, **options)
        instants: list[Instant] = []
        now = 0
        for arrival, camera, capture in sorted(self.arrivals):
            while (due := synchroniser.deadline_ns()) is not None and due < arrival:
                now = max(now, due)
                instants += synchroniser.poll(now)
            now = max(now, arrival)
            instants += synchroniser.push(picture(camera, capture), now)
        return synchroniser, instants, now


def filmed(cameras: int, frames: int, delays: tuple[int, ...] = (), start: int = 0) -> list[tuple[int, str, int]]:
    """Regular arrivals of a genlocked rig."""
    delays = delays or (20 * MS,) * cameras
    return [
        (k * PERIOD + delays[c], f"c{c}", UTC + k * PERIOD)
        for k in range(start, start + frames)
        for c in range(cameras)
    ]


NAMES = ("c0", "c1", "c2", "c3")


def check(instants: list[Instant]) -> None:
    """What holds whatever happens: order, nearness, each picture once."""
    numbers = [instant.number for instant in instants]
    assert numbers == sorted(set(numbers))
    seen: set[int] = set()
    for instant in instants:
        for taken in instant.pictures:
            if taken is not None:
                assert abs(taken.capture_ns - instant.capture_ns) <= PERIOD // 2 + 1
                assert id(taken) not in seen
                seen.add(id(taken))


def test_pairs_all_pictures_of_a_regular_rig() -> None:
    synchroniser, instants, now = Film(NAMES, filmed(4, 60, (5 * MS, 20 * MS, 40 * MS, 55 * MS))).run()
    check(instants)
    assert len(instants) >= 58
    for instant in instants:
        captures = [taken.capture_ns for taken in instant.pictures if taken is not None]
        assert len(captures) == 4
        assert len(set(captures)) == 1
    assert [count.missing for count in synchroniser.counts().values()] == [0] * 4
    assert not synchroniser.is_degraded(now)
    assert [instant.number for instant in instants] == list(range(len(instants)))


def test_gives_a_slot_out_once_complete_or_at_its_deadline() -> None:
    synchroniser = Synchroniser(("c0", "c1"), 30, quorum=1)
    synchroniser.push(picture("c0", UTC), 0)
    instants = synchroniser.push(picture("c1", UTC), MS)
    assert [instant.capture_ns for instant in instants] == [UTC]
    assert synchroniser.push(picture("c0", UTC + PERIOD), PERIOD) == []
    due = synchroniser.deadline_ns()
    assert due is not None
    assert PERIOD < due <= 3 * PERIOD + 1
    assert synchroniser.poll(due - 1) == []
    (instant,) = synchroniser.poll(due)
    assert instant.pictures[0] is not None
    assert instant.pictures[1] is None
    assert synchroniser.states(due)["c1"] is CameraState.LATE


def test_a_later_picture_settles_a_missing_one_before_the_deadline() -> None:
    arrivals = [entry for entry in filmed(2, 10) if entry[1:] != ("c1", UTC + 4 * PERIOD)]
    synchroniser, instants, _ = Film(("c0", "c1"), arrivals).run(quorum=1, deadline_ns=HOUR)
    assert [instant.number for instant in instants if instant.pictures[1] is None] == [4]
    assert len(instants) == 10
    assert synchroniser.counts()["c1"].missing == 1


@pytest.mark.parametrize(("quorum", "expected"), [(4, 0), (3, 30), (1, 30)])
def test_policies_decide_over_incomplete_slots(quorum: int, expected: int) -> None:
    arrivals = filmed(4, 30) + [entry for entry in filmed(4, 60, start=30) if entry[1] != "c2"]
    synchroniser, instants, now = Film(NAMES, arrivals).run(quorum=quorum)
    later = [instant for instant in instants if UTC + 30 * PERIOD <= instant.capture_ns < UTC + 60 * PERIOD]
    assert len(later) == expected
    assert all(instant.pictures[2] is None for instant in later)
    assert len(instants) + synchroniser.dropped + synchroniser.pending == 90
    assert (synchroniser.dropped > 50) == (expected == 0)
    assert synchroniser.is_degraded(now)
    assert synchroniser.states(now)["c2"] is CameraState.LOST
    silences = synchroniser.silences_ns(now)
    assert silences.pop("c2") > 29 * PERIOD > 10 * PERIOD > max(silences.values())
    synchroniser.leave("c0", now)
    assert synchroniser.silences_ns(now)["c0"] is None


def test_the_first_instant_has_all_pictures_unless_none_has_in_ten_seconds() -> None:
    """A scene is trained of it."""
    late = [entry for entry in filmed(4, 60) if entry[1] != "c2" or entry[2] - UTC not in (PERIOD, 2 * PERIOD)]
    without_first = [entry for entry in late if entry[1] != "c2" or entry[2] != UTC]
    _, instants, _ = Film(NAMES, [(5 * MS, "c2", UTC - PERIOD), *without_first]).run(quorum=3)
    check(instants)
    assert abs(instants[0].capture_ns - UTC - 3 * PERIOD) <= 1
    assert None not in instants[0].pictures
    alternately = [entry for entry in filmed(4, 600) if entry[0] // PERIOD % 2 or entry[1] != "c2"]
    alternately = [entry for entry in alternately if not entry[0] // PERIOD % 2 or entry[1] != "c1"]
    synchroniser, instants, _ = Film(NAMES, alternately).run(quorum=3)
    assert 290 <= synchroniser.dropped <= 310
    assert len(instants) >= 280


def test_a_stopped_camera_is_masked_counted_and_joins_again() -> None:
    """Two seconds of silence, then all the pictures of that time at once, as after SIGSTOP and SIGCONT."""
    arrivals = []
    for arrival, camera, capture in filmed(4, 240):
        stopped = camera == "c1" and 60 * PERIOD <= capture - UTC < 120 * PERIOD
        arrivals.append((max(arrival, 120 * PERIOD + capture % 1000) if stopped else arrival, camera, capture))
    synchroniser, instants, now = Film(NAMES, arrivals).run(quorum=3)
    check(instants)
    missing = [instant.number for instant in instants if instant.pictures[1] is None]
    assert 55 <= len(missing) <= 62
    assert all(instant.pictures[1] is not None for instant in instants[-60:])
    count = synchroniser.counts()["c1"]
    assert count.late >= 55
    assert count.missing == len(missing)
    assert set(synchroniser.states(now).values()) == {CameraState.OK}
    assert len(instants) >= 238


@pytest.mark.parametrize("comes_back_at", [0.65, 0.75])
def test_a_camera_that_comes_back_with_another_phase_is_paired_one_way_from_its_first_picture(
    comes_back_at: float,
) -> None:
    """Its new phase lies near the boundary between instants, which is best moved to the other side of some cameras."""
    phases = {"c0": 0.0, "c1": 0.4, "c2": 0.2, "c3": 0.4}
    arrivals = []
    for _, camera, capture in filmed(4, 300):
        number = (capture - UTC) // PERIOD
        if camera != "c2" or not 120 <= number < 180:
            phase = comes_back_at if camera == "c2" and number >= 180 else phases[camera]
            shift = round(phase * PERIOD)
            arrivals.append((number * PERIOD + shift + 20 * MS, camera, capture + shift))
    synchroniser, instants, _ = Film(NAMES, arrivals).run(quorum=3)
    check(instants)
    back = [instant for instant in instants if instant.capture_ns > UTC + 170 * PERIOD and None not in instant.pictures]
    assert len(back) >= 115
    assert synchroniser.shifts == 1
    for row in range(4):
        taken = [instant.pictures[row] for instant in back]
        since = {
            round((picture.capture_ns - UTC) / PERIOD - phases[NAMES[row]]) - instant.number
            for picture, instant in zip(taken, back, strict=True)
            if picture is not None
        }
        assert len(since) == 1


def test_a_skewed_camera_is_paired_with_what_it_saw_and_its_skew_is_told() -> None:
    """Fifty milliseconds are one period and a half, the worst case: the grid must be laid between the cameras."""
    generator = np.random.default_rng(3)
    arrivals = [
        (arrival, camera, capture + int(generator.normal(0, MS)) + (50 * MS if camera == "c3" else 0))
        for arrival, camera, capture in filmed(4, 150, (60 * MS,) * 4)
    ]
    synchroniser, instants, _ = Film(NAMES, arrivals).run(quorum=3)
    check(instants)
    counts = synchroniser.counts()
    settled = instants[30:-4]
    assert all(None not in instant.pictures for instant in settled)
    assert abs(abs(counts["c3"].skew_ns - counts["c0"].skew_ns) - PERIOD // 2) < 3 * MS
    assert counts["c3"].late == 0


def test_one_clock_stepped_by_an_hour_is_kept_out_and_the_others_go_on() -> None:
    arrivals = [
        (arrival, camera, capture + (HOUR if camera == "c0" and 60 <= (capture - UTC) // PERIOD < 120 else 0))
        for arrival, camera, capture in filmed(4, 180)
    ]
    synchroniser, instants, _ = Film(NAMES, arrivals).run(quorum=3)
    check(instants)
    assert len(instants) >= 178
    assert synchroniser.counts()["c0"].stray == 60
    assert synchroniser.steps == 0
    assert all(None not in instant.pictures for instant in instants[-50:])


@pytest.mark.parametrize(
    ("told", "fault"),
    [
        (lambda k: 60, TimeFault.STILL),
        (lambda k: 120 - k, TimeFault.BACK),
        (lambda k: k + 90, TimeFault.FAR),
        (lambda k: 60 if k < 110 else k, None),  # stood for less than two seconds
        (lambda k: k ^ 1, None),  # two and two in the wrong order, as a network may bring them
    ],
)
def test_times_that_stand_run_backwards_or_are_far_off_are_told_while_they_do(
    told: Callable[[int], int], fault: TimeFault | None
) -> None:
    """The camera's clock is well for two seconds, then `told` gives its times in periods, from which it recovers."""
    wrong = [
        (arrival, camera, UTC + told(k) * PERIOD if camera == "c2" and k >= 60 else capture)
        for arrival, camera, capture in filmed(4, 180)
        for k in [(capture - UTC) // PERIOD]
    ]
    synchroniser, instants, _ = Film(NAMES, wrong).run(quorum=3)
    check(instants)
    assert synchroniser.time_faults() == {"c0": None, "c1": None, "c2": fault, "c3": None}
    synchroniser, _, _ = Film(NAMES, wrong + filmed(4, 2, start=180)).run(quorum=3)
    assert set(synchroniser.time_faults().values()) == {None}


@pytest.mark.parametrize("step", [HOUR, -HOUR])
def test_all_clocks_stepped_by_an_hour_lay_the_grid_anew(step: int) -> None:
    arrivals = [
        (arrival, camera, capture + (step if capture - UTC >= 60 * PERIOD else 0))
        for arrival, camera, capture in filmed(4, 180)
    ]
    synchroniser, instants, _ = Film(NAMES, arrivals).run()
    check(instants)
    assert synchroniser.steps == 1
    after = [instant for instant in instants if (instant.capture_ns - UTC - step) > 0] if step > 0 else instants[60:]
    assert len(after) >= 110
    assert instants[-1].number == pytest.approx(179, abs=3)


def test_begins_without_a_camera_that_never_comes() -> None:
    arrivals = [entry for entry in filmed(4, 90) if entry[1] != "c3"]
    synchroniser, instants, now = Film(NAMES, arrivals).run(quorum=2, gather_ns=1_000 * MS)
    assert 60 <= len(instants) <= 72
    assert synchroniser.is_degraded(now)


def test_the_first_instant_waits_for_the_next_camera_not_since_the_first_one() -> None:
    """As of phones on which one person presses Film, one after the other; then for pictures of all of them."""
    begins = {"c0": 0, "c1": 25 * PERIOD, "c2": 50 * PERIOD, "c3": 75 * PERIOD}
    arrivals = [entry for entry in filmed(4, 120) if entry[2] - UTC >= begins[entry[1]]]
    _, instants, _ = Film(NAMES, arrivals).run(quorum=2, gather_ns=30 * PERIOD)
    assert None not in instants[0].pictures


def test_a_camera_that_left_is_not_waited_for() -> None:
    synchroniser = Synchroniser(("c0", "c1"), 30, quorum=1, deadline_ns=HOUR)
    synchroniser.push(picture("c0", UTC), 0)
    synchroniser.push(picture("c1", UTC), 0)
    assert synchroniser.push(picture("c0", UTC + PERIOD), PERIOD) == []
    assert len(synchroniser.leave("c1", PERIOD + 1)) == 1


@st.composite
def _chaos(draw: st.DrawFn) -> list[tuple[int, str, int]]:
    """Arrivals with jitter, losses, repeats, phases of their own, outages and steps of clocks."""
    cameras = draw(st.integers(1, 5))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    jitter, loss, repeat = draw(st.sampled_from([0, 2, 8, 40])), draw(st.sampled_from([0, 0.02, 0.3])), 0.02
    arrivals = []
    for c in range(cameras):
        phase = int(random.uniform(0, PERIOD)) if draw(st.booleans()) else 0
        drift = 1 + draw(st.sampled_from([0, 1e-4, -1e-3]))
        step, when = draw(st.sampled_from([0, 0, HOUR, -HOUR, 300 * MS])), int(random.integers(0, 90))
        for k in range(90):
            if random.random() < loss:
                continue
            capture = UTC + phase + int(k * PERIOD * drift) + int(random.normal(0, jitter / 4 * MS))
            arrival = k * PERIOD + int(random.exponential(jitter * MS)) + 5 * MS
            for _ in range(1 + (random.random() < repeat)):
                arrivals.append((arrival, f"c{c}", capture + (step if k >= when else 0)))
    return arrivals


@settings(max_examples=40, deadline=None)
@given(arrivals=_chaos(), quorum=st.integers(1, 5))
def test_whatever_comes_slots_are_ordered_near_and_without_repeats(
    arrivals: list[tuple[int, str, int]], quorum: int
) -> None:
    cameras = tuple(sorted({camera for _, camera, _ in arrivals}))
    synchroniser, instants, now = Film(cameras, arrivals).run(quorum=min(quorum, len(cameras)))
    instants += synchroniser.finish(now)
    check(instants)
    counts = synchroniser.counts()
    for row, name in enumerate(cameras):
        used = sum(instant.pictures[row] is not None for instant in instants)
        count = counts[name]
        assert used + count.late + count.duplicate + count.stray <= count.received
        assert count.received == sum(camera == name for _, camera, _ in arrivals)
    for instant in instants:
        assert sum(taken is not None for taken in instant.pictures) >= min(quorum, len(cameras))


def test_memory_stays_bounded_while_a_camera_runs_ahead() -> None:
    synchroniser = Synchroniser(("c0", "c1"), 30, deadline_ns=HOUR)
    synchroniser.push(picture("c1", UTC), 0)
    for k in range(10_000):  # pictures from the future, without time going on
        synchroniser.push(picture("c0", UTC + k * PERIOD), MS)
    assert synchroniser.pending <= 40
    assert synchroniser.counts()["c0"].stray > 9_000


def test_refuses_a_rig_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="quorum"):
        Synchroniser(("a", "b"), 30, quorum=3)
    with pytest.raises(ValueError, match="names"):
        Synchroniser(("a", "a"), 30)


def test_a_camera_that_is_always_late_is_waited_for_and_a_stalled_one_is_not() -> None:
    synchroniser, instants, _ = Film(NAMES, filmed(4, 150, (20 * MS, 20 * MS, 25 * MS, 220 * MS))).run(quorum=2)
    check(instants)
    assert all(None not in instant.pictures for instant in instants[-90:])
    assert synchroniser.counts()["c3"].late < 40
    assert len(instants) >= 140
