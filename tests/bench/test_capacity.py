"""The capacity model against a simulation of every viewer, and against sums that can be done by hand."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from tests.bench.capacity_bench import main, measured
from tests.bench.capacity_model import Demand, Figures, distinct, plan
from tests.bench.capacity_simulation import simulate


@pytest.mark.parametrize(
    "demand",
    [
        Demand(),  # a million viewers of a hundred streams
        Demand(viewers=200_000, streams=20, kbps=4000, regions=(0.1, 0.2, 0.3, 0.4), popularity=0.0),
        Demand(viewers=50_000, streams=500, kbps=300, regions=(0.5, 0.5), popularity=1.5),
    ],
)
def test_the_simulation_agrees_where_a_region_is_lost(demand: Demand) -> None:
    figures = Figures(cores=4)
    planned = plan(demand, figures)
    seen = simulate(demand, figures, planned)
    assert seen.origin_bytes == pytest.approx(planned.origin_bytes, rel=0.02)
    assert seen.parent_bytes == pytest.approx(planned.parent_bytes, rel=0.02)
    assert seen.load == pytest.approx(planned.load, rel=0.01)
    assert seen.load_after == pytest.approx(planned.load_after, rel=0.03)
    assert seen.recovery_seconds == pytest.approx(planned.recovery_seconds, rel=0.25)  # edges are not all as full
    assert seen.worst_load_after < 1  # so that nobody is without pictures
    assert math.isfinite(seen.last_seconds)


def test_without_room_for_a_lost_region_viewers_wait_for_ever() -> None:
    """What would be if the plan were made without the loss: both say so."""
    demand, full = Demand(viewers=20_000, regions=(0.5, 0.5)), Figures(use=1.3)
    planned = plan(demand, full)
    assert planned.recovery_seconds == math.inf
    assert planned.load_after > 1
    assert simulate(demand, full, planned).recovery_seconds == math.inf


def test_sums_by_hand() -> None:
    demand = Demand(viewers=8000, streams=10, kbps=800, regions=(0.5, 0.5), retention_seconds=60)
    figures = Figures(
        bytes_per_cpu_second=1e7,
        cores=4,
        gigabits=10,
        use=0.5,
        edge_hour=2,
        gpu_hour=3,
        gigabyte=0.01,
        gigabyte_month=0.73,
    )
    planned = plan(demand, figures)
    # each region has to carry all: 8000 viewers of 100 kB/s at 5 MB/s an edge
    assert planned.edges == (160, 160)
    assert planned.machines == 80
    assert planned.load == pytest.approx(0.25)
    assert planned.load_after == pytest.approx(0.5)
    assert (planned.gpus, planned.storage_bytes) == (10, 10 * 100e3 * 60 * 3)
    assert planned.hour == pytest.approx(80 * 2 + 10 * 3 + 8000 * 100e3 * 3600 / 1e9 * 0.01 + 0.18 * 0.001)
    assert Figures(gigabits=0.1, cores=1).edge_bytes == pytest.approx(12.5e6)  # its network, not its core
    assert distinct(Demand(streams=4, popularity=0).shares, 1) == pytest.approx(1)
    with pytest.raises(ValueError, match="sum to 1"):
        plan(Demand(regions=(0.5, 0.4)), figures)


def test_the_command_takes_what_was_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [{"held": True, "bytes_per_cpu_second": 5e7}, {"held": False, "bytes_per_cpu_second": 9e7}]
    file, out = tmp_path / "crowd.json", tmp_path / "plan.json"
    file.write_text(json.dumps({"rows": rows}))
    given = ["--figures", str(file), "--viewers", "10000", "--regions", "0.5,0.5", "--simulate", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", ["capacity", *given])
    main()
    assert "an edge: 50 MB/s at most" in capsys.readouterr().out
    assert json.loads(out.read_text())["edges"] == [42, 42]  # 1.25 GB/s at 30 MB/s each
    file.write_text('{"rows": []}')
    with pytest.raises(InputError, match="no number of viewers"):
        measured(file)
