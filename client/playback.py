"""The viewer's side of docs/protocol.md without a socket: messages in, events out, messages to send."""

from __future__ import annotations

import json
import re
from typing import Any

from streamlod.client.events import Event, NewScene, Notice, Welcome
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import BitstreamError, SessionError

PROTOCOL_VERSION = 1
_ACK_SECONDS = 1.0
_MAX_TEXT_BYTES = 65536  # of a control message from the server
_MAX_FPS = 10_000
_MAX_EDGES = 64  # of a list; further ones are left out
_ADDRESS = re.compile(r"https?://[A-Za-z0-9.:\[\]-]{1,255}/?")
_STREAM_EVENTS = frozenset({"state", "progress", "epoch", "window", "draining"})
_EVENTS = _STREAM_EVENTS | {"position", "levels", "skipped", "caught_up", "presenter"}


class Playback:
    """The state of one connection: decoder, newest scene, and bytes to acknowledge.

    Args:
        limits: of the decoder.

    Attributes:
        position: (epoch, version) of the newest scene, or None.
        mode: "live", "replay" or "paused".
    """

    def __init__(self, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self._decoder = SceneDecoder(limits)
        self._epoch = 0
        self._ack_every = 1
        self._bytes = 0
        self._unacknowledged = 0
        self._acknowledged_at = 0.0
        self._welcomed = False
        self.position: tuple[int, int] | None = None
        self.mode = "live"

    def hello(self, start: tuple[int, int] | None = None, levels: int | None = None) -> str:
        """The first message. `start` is a position (epoch, version) to replay from; the live edge by default."""
        message: dict[str, Any] = {"type": "hello", "versions": [PROTOCOL_VERSION], "client": "streamlod/0.1"}
        message["start"] = "live" if start is None else {"epoch": start[0], "version": start[1]}
        if levels is not None:
            message["levels"] = levels
        return json.dumps(message)

    def receive_text(self, text: str) -> list[Event]:
        """Handle a control message.

        Raises:
            SessionError: it is malformed, or not a control message.
        """
        message = _object(text)
        kind = message["type"]
        if kind == "welcome":
            return [self._welcome(message)]
        name = message.get("event")
        if kind != "event" or not isinstance(name, str) or name not in _EVENTS:
            return []
        fields = {key: value for key, value in message.items() if key not in {"type", "event"}}
        if name == "epoch":
            self._epoch = _whole(message, "epoch")
        elif name == "position":
            self.mode = str(message.get("mode", "live"))
            if message.get("epoch") is not None:
                self._epoch = _whole(message, "epoch")
        return [Notice(name, fields)]

    def receive_packet(self, packet: bytes, now: float) -> list[Event]:
        """Handle a packet.

        Args:
            now: seconds of a monotonic clock.

        Raises:
            SessionError: a packet came before the welcome, or the decoder refuses it, because something was lost.
        """
        if not self._welcomed:
            raise SessionError(CloseCode.BAD_MESSAGE, "a packet came before the welcome")
        if self._unacknowledged == 0:
            self._acknowledged_at = max(self._acknowledged_at, now - _ACK_SECONDS / 2)
        self._bytes += len(packet)
        self._unacknowledged += 1
        try:
            info = self._decoder.push(packet)
        except BitstreamError as error:
            raise SessionError(CloseCode.BAD_MESSAGE, f"packet refused: {error}"[:120]) from error
        scene = self._decoder.scene
        if scene is None:
            return []
        self.position = (self._epoch, scene.version)
        return [NewScene(scene, self._decoder.current_levels, info)]

    def acknowledgement(self, now: float) -> str | None:
        """The ack message if one is due."""
        waited = now - self._acknowledged_at >= _ACK_SECONDS
        if self._unacknowledged == 0 or not (waited or self._unacknowledged >= self._ack_every):
            return None
        self._unacknowledged, self._acknowledged_at = 0, now
        message: dict[str, Any] = {"type": "ack", "bytes": self._bytes}
        if self.position is not None:
            message["epoch"], message["version"] = self.position
        return json.dumps(message)

    def _welcome(self, message: dict[str, Any]) -> Welcome:
        if message.get("version") != PROTOCOL_VERSION:
            raise SessionError(
                CloseCode.BAD_VERSION, f"the server speaks protocol version {message.get('version')!r}, not 1"
            )
        self._welcomed = True
        if message.get("epoch") is not None:  # there is none before the first keyframe; an event announces it then
            self._epoch = _whole(message, "epoch")
        self._ack_every = max(1, _whole(message, "ack_every"))
        levels, fps = message.get("levels"), message.get("fps")
        return Welcome(
            str(message.get("stream", "")),
            str(message.get("state", "")),
            self._epoch,
            levels if isinstance(levels, int) else None,
            float(fps) if isinstance(fps, int | float) and 0 < fps <= _MAX_FPS else None,
            edges_in(message.get("edges")),
            str(message.get("incarnation", "")),
            isinstance(message.get("sound"), dict),
        )


def edges_in(value: object) -> tuple[str, ...]:
    """The addresses in a field `edges`; whatever else it holds is left out."""
    listed = value if isinstance(value, list) else []
    return tuple(each for each in listed[:_MAX_EDGES] if isinstance(each, str) and _ADDRESS.fullmatch(each))


def _object(text: str) -> dict[str, Any]:
    if len(text) > _MAX_TEXT_BYTES:
        raise SessionError(CloseCode.TOO_BIG, f"a control message of {len(text)} characters is too long")
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SessionError(CloseCode.BAD_MESSAGE, "a text message is not JSON") from error
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise SessionError(CloseCode.BAD_MESSAGE, "a text message is not an object with a type")
    return message


def _whole(message: dict[str, Any], key: str) -> int:
    value = message.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise SessionError(CloseCode.BAD_MESSAGE, f"{key} of a {message['type']} message is not a whole number")
    return value
