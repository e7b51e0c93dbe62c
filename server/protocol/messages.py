"""Control messages of the viewer protocol `streamlod.v1`: parsed, or refused with the documented close codes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.protocol.fields import flag, whole
from streamlod.server.protocol.packets import Position
from streamlod.server.protocol.presenting import Follow, Present, parse_presenting
from streamlod.server.protocol.thin_messages import Pick, Shown, ViewMessage, parse_view_message

SUBPROTOCOL = "streamlod.v1"
PROTOCOL_VERSION = 1
LIVE = "live"
ACK_EVERY = 32  # packets

_MIN_SPEED, _MAX_SPEED = 0.125, 8.0  # of a replay


@dataclass(frozen=True, slots=True)
class Hello:
    """A viewer's first message; None stands for "no limit", and `start` None for the live edge.

    `pictures` asks for pictures instead of packets, `relay` for every packet as it was published, from `start` on,
    `sound` for live sound.
    """

    client: str
    start: Position | None
    levels: int | None
    kilobytes_per_second: float | None
    pictures: bool = False
    relay: bool = False
    sound: bool = False


@dataclass(frozen=True, slots=True)
class Ack:
    """Bytes of packets received so far."""

    received_bytes: int


@dataclass(frozen=True, slots=True)
class Set:
    """New settings of the viewer; only the fields named in `given` were sent."""

    levels: int | None
    kilobytes_per_second: float | None
    given: frozenset[str]
    speed: float = 1.0
    sound: bool = False


@dataclass(frozen=True, slots=True)
class Seek:
    """Jump to a position; None is the live edge. `stop`: pause there (only where the server draws)."""

    to: Position | None
    stop: bool = False


@dataclass(frozen=True, slots=True)
class Pause:
    """Stop sending."""


@dataclass(frozen=True, slots=True)
class Play:
    """Go on after a pause."""


Control = Ack | Set | Seek | Pause | Play | ViewMessage | Shown | Pick | Present | Follow


def parse_hello(text: str) -> Hello:
    """A viewer's first message.

    Raises:
        SessionError: 4400 malformed, 4415 no common version.
    """
    message = read_object(text)
    if message.get("type") != "hello":
        raise SessionError(CloseCode.BAD_MESSAGE, "the first message must be a hello")
    versions = message.get("versions")
    if not isinstance(versions, list) or len(versions) > 64:
        raise SessionError(CloseCode.BAD_MESSAGE, "hello needs a list of versions")
    if PROTOCOL_VERSION not in [v for v in versions if type(v) is int]:
        fault = f"this server speaks version {PROTOCOL_VERSION} of the protocol, and hello names others"
        raise SessionError(CloseCode.BAD_VERSION, fault)
    client = message.get("client", "")
    if not isinstance(client, str) or len(client) > 200 or not client.isprintable():  # because it is logged
        raise SessionError(CloseCode.BAD_MESSAGE, "client must be a string of at most 200 printable characters")
    start, flags = _target(message.get("start", LIVE), "start"), ("pictures", "relay", "sound")
    pictures, relay, sound = (flag(message, name) for name in flags)
    return Hello(client, start, _levels(message), _rate(message), pictures, relay, sound)


def parse_control(text: str) -> Control:
    """Any later message.

    Raises:
        SessionError: 4400, it is malformed or unknown.
    """
    message = read_object(text)
    match message.get("type"):
        case "ack" if "picture" not in message:
            return Ack(whole(message.get("bytes"), "bytes"))
        case "set":
            given = frozenset(message) & {"levels", "kilobytes_per_second", "speed", "sound"}
            return Set(_levels(message), _rate(message), given, _speed(message), flag(message, "sound"))
        case "seek":
            return Seek(_target(message.get("to"), "to"), flag(message, "stop"))
        case "pause" | "play" as kind:
            return Pause() if kind == "pause" else Play()
        case "ack" | "view" | "pick":
            return parse_view_message(message)
        case "present" | "follow":
            return parse_presenting(message)
    known = "ack, set, seek, pause, play, view, pick, present, follow"
    raise SessionError(CloseCode.BAD_MESSAGE, f"message type is not one of {known}")


def welcome(
    stream: dict[str, Any],
    window: dict[str, Any] | None,
    session: str,
    now_ns: int,
    edges: Sequence[str] = (),
    together: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """The answer to a hello, from STREAM of docs/protocol.md.

    Args:
        now_ns: Unix time of its packets' clock.
        edges: addresses of servers that serve the same stream.
        together: who presents, and whether the viewer may.
    """
    names = ("incarnation", "source", "loop", "sound", "state", "detail", "progress", "epoch", "levels", "fps")
    return {
        "type": "welcome", "version": PROTOCOL_VERSION, "session": session, "stream": stream["id"],
        **{name: stream[name] for name in names},
        "window": window, "ack_every": ACK_EVERY, "server_time_ns": now_ns, "edges": list(edges), "together": together,
    }  # fmt: skip


def event(name: str, **fields: Any) -> dict[str, Any]:
    """An event message."""
    return {"type": "event", "event": name, **fields}


def read_object(text: str) -> dict[str, Any]:
    """A control message.

    Raises:
        SessionError: 4400, it is not a JSON object.
    """
    try:
        message = _READER.decode(text)
    except (ValueError, RecursionError) as error:
        raise SessionError(CloseCode.BAD_MESSAGE, "message is not JSON") from error
    if not isinstance(message, dict):
        raise SessionError(CloseCode.BAD_MESSAGE, "message is not a JSON object")
    return message


def _refuse_constant(name: str) -> float:
    raise ValueError(name)


_READER = json.JSONDecoder(parse_constant=_refuse_constant)


def _target(value: object, name: str) -> Position | None:
    if value == LIVE:
        return None
    if not isinstance(value, dict):
        raise SessionError(CloseCode.BAD_MESSAGE, f'{name} must be "live" or a position')
    return Position(whole(value.get("epoch"), "epoch"), whole(value.get("version"), "version"))


def _levels(message: dict[str, Any]) -> int | None:
    value = message.get("levels")
    if value is None:
        return None
    if type(value) is not int or not 1 <= value <= 64:
        raise SessionError(CloseCode.BAD_MESSAGE, "levels must be an integer from 1 to 64")
    return value


def _speed(message: dict[str, Any]) -> float:
    value = message.get("speed", 1)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _MIN_SPEED <= value <= _MAX_SPEED:
        raise SessionError(CloseCode.BAD_MESSAGE, f"speed must be a number from {_MIN_SPEED} to {_MAX_SPEED}")
    return float(value)


def _rate(message: dict[str, Any]) -> float | None:
    value = message.get("kilobytes_per_second")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 1 <= value <= 1e9:
        raise SessionError(CloseCode.BAD_MESSAGE, "kilobytes_per_second must be a number from 1 to 1e9")
    return float(value)
