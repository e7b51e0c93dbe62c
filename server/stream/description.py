"""STREAM of docs/protocol.md: what a stream says of itself, its state, newest position, progress and figures."""

from __future__ import annotations

from typing import Any

from streamlod.core.masking import masked
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.stream import Stream


def describe(stream: Stream) -> dict[str, Any]:
    """STREAM of docs/protocol.md."""
    scene, newest = stream.hub.scene, stream.newest
    return {
        "id": stream.id,
        "name": stream.id,
        "incarnation": stream.incarnation,
        "source": stream.source,
        "loop": stream.loop,
        "sound": stream.sound,
        "state": stream.state,
        "detail": masked(stream.detail),
        "epoch": newest.epoch if newest else None,
        "version": newest.version if newest else None,
        "fps": scene.header.fps if scene else None,
        "levels": stream.levels,
        "anchors": scene.anchor_count if scene else None,
        "viewers": stream.viewers,
        "restarts": stream.restarts,
        "recording": _recording_state(stream.bus),
        "progress": stream.progress,
        "report": stream.report,
        "ingest": masked(stream.ingest),
        "camera_pictures": sorted(stream.camera_pictures),
        "created_at": stream.created_at.isoformat(timespec="seconds").replace("+00:00", "Z"),
        "live_path": f"/v1/streams/{stream.id}/live",
    }


def _recording_state(bus: Bus) -> str:
    return (bus.recording.fault or "on") if bus.recording is not None and bus.keeps else "off"
