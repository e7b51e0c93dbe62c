"""Sends the packets of a recorded file to the supervisor at the pace at which they were filmed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from streamlod.core.gaps import MAX_GAP_SECONDS
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker.messages import Resume, Sender, Tag

_BEHIND_SECONDS = 2.0  # that playing a file may be late and still catch up


def play(spec: StreamSpec, resume: Resume, sender: Sender) -> None:
    """Send the packets of a recorded file at the pace at which they were filmed."""
    from streamlod.codec.packet.packet import PacketKind
    from streamlod.server.pipeline.recorded import streamed_packets, whole_packets

    assert spec.play is not None
    state, entries = _file_state(spec.play), streamed_packets(spec.play)
    start, damaged = 0, set[int]()
    if resume.frames:
        done = min(resume.frames, len(entries)) - 1
        start = max(n for n in range(done + 1) if entries[n][1].kind is PacketKind.KEY)
    while True:
        begin = time.monotonic() - entries[start][1].time_ns / 1e9
        for number, info, data in whole_packets(spec.play, entries, damaged):
            if number < start:
                continue
            wait = begin + info.time_ns / 1e9 - time.monotonic()
            if wait < -_BEHIND_SECONDS:  # nobody watched, and it had to wait: go on from here
                begin -= wait
            begin -= max(0.0, wait - MAX_GAP_SECONDS)  # nobody waits while nothing was filmed
            time.sleep(min(max(0.0, wait), MAX_GAP_SECONDS))
            sender.send(Tag.PACKET, data)
            sender.send(Tag.REPORT, {"version": info.to_version, "done": number + 1})
        if not spec.loop:
            return
        time.sleep(_frame_seconds(entries))
        sender.send(Tag.EPOCH)
        start = 0
        if (now := _file_state(spec.play)) != state:  # somebody has put another one in its place
            state, entries, damaged = now, streamed_packets(spec.play), set()


def _file_state(path: Path) -> tuple[int, int] | None:
    """Time and size of a file, which change with its content; None where there is no such file."""
    with suppress(OSError):
        found = path.stat()
        return found.st_mtime_ns, found.st_size
    return None


def _frame_seconds(entries: Sequence[tuple[int, Any]]) -> float:
    """Pause between the last frame and the first one of the next round."""
    first, last = entries[0][1], entries[-1][1]
    frames = last.to_version - first.to_version
    return float(min(1.0, max(0.01, (last.time_ns - first.time_ns) / 1e9 / frames))) if frames else 1.0
