"""The events of a viewer session."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from streamlod.codec.packet.info import PacketInfo
from streamlod.core.scene.anchors import Scene


@dataclass(frozen=True, slots=True)
class Welcome:
    """The server accepted us.

    `state` is one of a stream (docs/protocol.md), such as ``live``; `levels` and `fps` are None before the first
    keyframe; `edges` are addresses of servers at which the same stream can be watched. A position names a picture only
    within one `incarnation` of the stream.
    """

    stream: str
    state: str
    epoch: int
    levels: int | None
    fps: float | None
    edges: tuple[str, ...] = ()
    incarnation: str = ""
    has_sound: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class NewScene:
    """A packet was applied.

    Attributes:
        scene: the state now.
        levels: how many levels, coarse ones first, are at the scene's version; the others must not be drawn.
        info: the packet.
    """

    scene: Scene
    levels: int
    info: PacketInfo


@dataclass(frozen=True, slots=True)
class Notice:
    """An event of docs/protocol.md.

    state, progress, epoch, position, levels, skipped, caught_up, window or draining.
    """

    name: str
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The connection broke; another attempt follows after `delay_seconds`."""

    reason: str
    delay_seconds: float


Event = Welcome | NewScene | Notice | Disconnected
