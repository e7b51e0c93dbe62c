"""Messages from a worker to its supervisor, by pipe, and where its supervisor tells it to continue.

A message is one byte, its `Tag`, and a body.
"""

from __future__ import annotations

import json
import math
import threading
from dataclasses import dataclass
from enum import IntEnum
from multiprocessing.connection import Connection
from typing import Any


class Tag(IntEnum):
    """First byte of a message."""

    PACKET = 1  # the packet
    PREVIEW = 2  # an early keyframe, shown but not recorded
    REPORT = 3  # JSON: figures of a finished frame
    PROGRESS = 4  # JSON: fraction, loss, text; or null
    FAILURE = 5  # JSON: text, fatal, and refused, a `Shortage`, where there was no room for it
    EPOCH = 6  # empty: versions begin anew
    END = 7  # empty: the source has no more frames
    HEARTBEAT = 8  # resident memory in bytes, as 8 bytes
    INGEST = 9  # JSON: figures of live cameras, and whether training waits for them
    PICTURES = 10  # of `camera_pictures`
    PLACED = 11  # JSON: node of the cluster that the worker runs on
    SOUND = 12  # a piece of live sound, of `codec.mp4.sound`
    MICROPHONE = 13  # JSON: camera at which live sound is heard, or null; comes before sound


@dataclass(frozen=True, slots=True)
class Resume:
    """Where a restarted worker continues.

    Attributes:
        packets: a keyframe and, where it is older than the state, the residual that leads there.
        frames: number of frames of the source that are done.
    """

    packets: tuple[bytes, ...] = ()
    frames: int = 0


def send_resume(resume: Resume, pipe: Connection) -> None:
    """Tell a worker where to continue; blocks until it listens."""
    pipe.send_bytes(json.dumps({"frames": resume.frames, "packets": len(resume.packets)}).encode())
    for packet in resume.packets:
        pipe.send_bytes(packet)


def receive_resume(pipe: Connection) -> Resume:
    """The state that `send_resume` sent."""
    told = json.loads(pipe.recv_bytes())
    return Resume(tuple(pipe.recv_bytes() for _ in range(told["packets"])), told["frames"])


class Sender:
    """Messages to the supervisor, from several threads."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._lock = pipe, threading.Lock()

    def send(self, tag: Tag, body: bytes | dict[str, Any] = b"") -> None:
        """Send one message; blocks while the supervisor is behind."""
        data = body if isinstance(body, bytes) else json.dumps(_plain(body)).encode()
        with self._lock:
            self._pipe.send_bytes(bytes((tag,)) + data)


def _plain(value: Any) -> Any:
    """`value` as JSON has it: plain numbers, and none that are not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    return float(value) if math.isfinite(float(value)) else None
