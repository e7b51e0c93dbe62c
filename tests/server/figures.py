"""Figures of live cameras, as a worker tells them."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

from streamlod.server.ingest.statistics import CameraStatistics, Statistics
from streamlod.server.ingest.sync.camera_track import CameraState, Counts
from streamlod.server.ingest.sync.clock import ClockSource


def figures(
    state: CameraState = CameraState.OK, fault: str = "", *, waiting: bool = False, knocked: bool = False
) -> dict[str, Any]:
    """What a worker tells of two cameras, one of them in this state."""
    one = CameraStatistics(CameraState.OK, ClockSource.NTP, 1_000_000, -3.5, Counts(7, 1, 2, 3, 4, -2_000_000), 1, "")
    one = replace(one, shift=35.2 if knocked else None, knocked=knocked)
    other = CameraStatistics(state, None, 0, 0.0, Counts(), 2, fault)
    rig = Statistics(state is CameraState.LOST, waiting, 5, 6, 7, 8_000_000, 9, {"cam0": one, "cam1": other})
    told: dict[str, Any] = json.loads(json.dumps(asdict(rig)))
    return told
