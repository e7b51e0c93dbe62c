"""A worker's report on live cameras, as sentences."""

from __future__ import annotations

from typing import Any

from streamlod.server.ingest.sync.synchroniser import CameraState


def complaint(figures: dict[str, Any]) -> str:
    """Which cameras deliver nothing that can be used, and why, in a sentence; empty where none is.

    Args:
        figures: `server.ingest.statistics.Statistics` in JSON, as `Tag.INGEST` has them.
    """
    parts = []
    for name, one in figures["cameras"].items():
        if one["state"] == CameraState.LOST:
            parts.append(f"camera {name} is lost" + (f" ({one['fault']})" if one["fault"] else ""))
        elif one.get("refused"):
            parts.append(f"camera {name} {one['refused']}")
    return "; ".join(parts)
