"""Capture clocks: which evidence counts, how robust the fits are, time codes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from streamlod.core.camera.grid import Grid, best_phase, period_of
from streamlod.server.ingest.sync.clock import CaptureClock, ClockSource, Sighting, date_timecode, read_timecode
from streamlod.server.ingest.sync.clock_fit import Line

MS, SECOND = 1_000_000, 1_000_000_000
HOUR = 3600 * SECOND
UTC = 1_790_000_000 * SECOND


def test_a_line_finds_offset_and_drift_among_noise_and_wrong_pairs() -> None:
    generator = np.random.default_rng(0)
    line = Line()
    for k in range(60):
        x = k * SECOND
        wrong = 40 * MS if k % 7 == 3 else 0
        line.add(x, UTC + x + round(80e-6 * x) + round(generator.normal(0, 50_000)) + wrong)
    assert line.drift_ppm == pytest.approx(80, abs=4)
    assert abs(line.at(70 * SECOND) - (UTC + 70 * SECOND + 5_600_000)) < 300_000
    assert 10_000 < line.error_ns < 300_000


def test_a_line_ignores_one_wild_pair_and_follows_a_step() -> None:
    line = Line()
    for k in range(10):
        line.add(k * SECOND, k * SECOND)
    line.add(10 * SECOND, 10 * SECOND + HOUR)
    assert line.at(11 * SECOND) == 11 * SECOND
    line.add(11 * SECOND, 11 * SECOND + HOUR)
    assert line.at(12 * SECOND) == 12 * SECOND + HOUR
    assert line.steps == 1


def test_the_envelope_is_the_least_delay() -> None:
    generator = np.random.default_rng(1)
    clock = CaptureClock(30)
    captures = []
    for k in range(900):
        media = k * SECOND // 30
        delay = 20 * MS + round(generator.exponential(15 * MS))
        found = clock.capture(Sighting(UTC + media + delay, media))
        if found is not None:
            assert found.source is ClockSource.ARRIVAL
            captures.append(found.capture_ns - UTC - media)
    assert 869 <= len(captures) <= 871  # the first second only tells how long the way is
    assert max(abs(late - 20 * MS) for late in captures[30:]) < 4 * MS
    assert np.ptp(captures[30:]) < 3 * MS


def test_the_envelope_survives_a_stall_and_a_backlog() -> None:
    clock = CaptureClock(30)
    offsets = []
    for k in range(600):
        media = k * SECOND // 30
        arrival = media + 20 * MS
        if k < 15:
            arrival = 500 * MS + k  # waiting in buffers when we connected
        if 300 <= k < 360:
            arrival = 12 * SECOND + 20 * MS + k  # all at once after two seconds of silence
        found = clock.capture(Sighting(UTC + arrival, media))
        if found is not None:
            offsets.append(found.capture_ns - UTC - media)
    assert max(offsets) - min(offsets) < MS


def test_trusts_reports_above_stated_times_above_codes_above_numbers_above_arrival() -> None:
    clock = CaptureClock(30, epoch_ns=UTC)
    seen = {
        ClockSource.FRAME_NUMBER: {"frame_number": 30},
        ClockSource.TIMECODE: {"timecode_ns": (UTC + 3 * MS) % (24 * HOUR)},
        ClockSource.STATED: {"stated_ns": UTC + 2 * MS},
    }
    known: dict[str, int] = {"media_ns": 0}
    for source, fields in seen.items():
        known |= fields
        found = clock.capture(Sighting(UTC + 9 * MS, **known))
        assert found is not None
        assert found.source is source
        assert found.capture_ns == UTC + {"frame_number": SECOND, "timecode": 3 * MS, "stated": 2 * MS}[source.value]
    clock.observe_report(0, UTC + MS)
    found = clock.capture(Sighting(UTC + 9 * MS, **known))
    assert found is not None
    assert (found.source, found.capture_ns) == (ClockSource.NTP, UTC + MS)


def test_waits_for_reports_where_they_are_expected_but_not_for_ever() -> None:
    clock = CaptureClock(30, expects_ntp=True)
    sources = [clock.capture(Sighting(UTC + k * SECOND, k * SECOND)) for k in range(10)]
    assert [found is None for found in sources] == [True] * 6 + [False] * 4
    clock.observe_report(0, UTC - 30 * MS)
    found = clock.capture(Sighting(UTC + 10 * SECOND, 10 * SECOND))
    assert found is not None
    assert (found.source, found.capture_ns) == (ClockSource.NTP, UTC + 10 * SECOND - 30 * MS)


def test_a_sender_whose_clock_was_never_set_or_is_stepped_counts_by_arrival() -> None:
    clock = CaptureClock(30)
    for k in range(40):
        clock.observe_report(k * SECOND, (UTC if k < 20 else 0) + k * SECOND)
        found = clock.capture(Sighting(UTC + k * SECOND + 10 * MS, k * SECOND))
        assert found is not None, k
        assert abs(found.capture_ns - UTC - k * SECOND) <= 10 * MS
        assert found.source is (ClockSource.NTP if k < 21 else ClockSource.ARRIVAL)


def test_timecodes_of_day() -> None:
    packed = 0x12 << 24 | 0x34 << 16 | 0x56 << 8 | 0x07  # 07:56:34:12 as FFmpeg packs it
    assert read_timecode(packed, Fraction(25)) == ((7 * 60 + 56) * 60 + 34) * SECOND + 480 * MS
    assert read_timecode(0x29 << 24, Fraction(25)) is None  # frame 29 of 25
    drop = 1 << 30 | 0x02 << 24 | 0x01 << 8  # 00:01:00;02 follows 00:00:59;29
    assert read_timecode(drop, Fraction(30000, 1001)) == round(1800 * Fraction(1001, 30000) * SECOND)
    assert read_timecode(0x10 << 24 | 1 << 7, Fraction(50)) == 21 * 20 * MS
    midnight = UTC - UTC % (24 * HOUR)
    assert date_timecode(24 * HOUR - SECOND, midnight + SECOND) == midnight - SECOND
    assert date_timecode(SECOND, midnight - SECOND) == midnight + SECOND


def test_the_grid_lies_where_cameras_are_told_apart() -> None:
    grid = Grid(period_of(29.97), 5, UTC)
    assert grid.period_ns == Fraction(1001 * SECOND, 30000)
    for number in (-7, 5, 10**6):
        time = grid.time_of(number)
        half = int(grid.period_ns / 2)
        assert {grid.instant_of(time + off) for off in (-half + 1, 0, half - 1)} == {number}
    assert best_phase([0.0, 0.01, -0.01]) == pytest.approx(0, abs=1e-5)
    for phases in ([0.0, 0.5, 0.02], [0.49, -0.49, 0.3], [0.1]):
        centre = best_phase(phases)
        off = max(abs(phase - centre - round(phase - centre)) for phase in phases)
        assert off <= 0.26
        assert -0.5 < centre <= 0.5
