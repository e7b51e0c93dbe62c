"""One viewer's session: what it gets next, and when.

A viewer has no queue. It has a place in the hub's window, and whenever its socket takes more, the next packet is
chosen from there: the following one, or one residual over everything it missed. So a slow viewer costs a socket buffer.

A viewer that is up to date and whose socket is empty gets a new packet straight from the hub's call, without its task
being woken: that is the ordinary case, and makes a packet to a thousand viewers a loop over sockets.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import time
from collections import deque
from typing import Any, Protocol

from core.errors import SessionError
from server.messages import BUSY, DONE, FLOOD, STOPPING, Ack, Control, Hello, Pause, Play, Seek, Set, event
from server.pacing import LevelControl, Throttle
from server.packets import Position, StreamPacket, binary_frame
from server.settings import Limits
from server.stream import Stream

_LOG = logging.getLogger(__name__)
_ACK_EVERY = 8
_TICK_SECONDS = 1.0
_CHUNK_VERSIONS = 16  # of the past, read at once
_LONGEST_GAP_SECONDS = 2.0
_MOST_LEVELS = 64


class Transport(Protocol):
    """What a session writes to; either call waits until earlier writes have drained."""

    async def binary(self, frame: bytes) -> None:
        """Send a packet that is framed already."""

    async def text(self, message: str) -> None:
        """Send a control message."""

    def offer(self, frame: bytes) -> bool:
        """Send a framed packet now, if earlier writes have drained; whether that was so."""


class ViewerSession:
    """A viewer that has said hello.

    Args:
        stream: what it watches.
        hello: its wishes.
        transport: its connection.
        limits: of the server.
    """

    def __init__(self, stream: Stream, hello: Hello, transport: Transport, limits: Limits) -> None:
        self._stream, self._hub, self._transport, self._limits = stream, stream.hub, transport, limits
        self.id = secrets.token_hex(6)
        self.client = hello.client
        self.draining = False
        self.wake = asyncio.Event()
        now = time.monotonic()
        wanted = hello.levels or _MOST_LEVELS
        self._levels = LevelControl(wanted, wanted, quiet_since=now)
        self._throttle = _throttle(hello.kilobytes_per_second)
        self._free_at = 0.0
        self._target: Position | None = hello.start
        self._live: int | None = None  # number of the newest packet sent from the hub
        self._last: StreamPacket | None = None  # newest packet applied by the viewer
        self._replay: deque[StreamPacket] = deque()
        self._clock = 0.0  # monotonic time that stands for presentation time 0
        self._mode = "replay" if hello.start else "live"
        self._jump = True  # a position event and a new start are due
        self._told_caught_up = self._tell_levels = False
        self._up_to_date = False  # nothing is to be done but to pass on what comes
        self._full = False  # waits for acknowledgements
        self._sent = self._acked = 0
        self._acked_at: float | None = None
        self._held_seconds = 0.0  # spent waiting for the viewer since it was last up to date
        self._windowed_at = now
        self._allowance, self._allowance_at = 2 * limits.messages_per_second, now
        self._begun = now

    def on_control(self, message: Control) -> None:
        """Take a control message; its effect comes with the next step.

        Raises:
            SessionError: 4429, too many.
        """
        now = time.monotonic()
        rate = self._limits.messages_per_second
        self._allowance = min(2 * rate, self._allowance + rate * (now - self._allowance_at)) - 1
        self._allowance_at = now
        if self._allowance < 0:
            raise SessionError(FLOOD, f"more than {rate:g} messages a second")
        match message:
            case Ack(received):
                self._acked = max(self._acked, min(received, self._sent))
                self._acked_at = now
                if not self._full:
                    return
            case Set(levels, rate_kilobytes, given):
                if "levels" in given:
                    self._levels.want(levels or _MOST_LEVELS, now)
                    self._tell_levels = True
                if "kilobytes_per_second" in given:
                    self._throttle, self._free_at = _throttle(rate_kilobytes), 0.0
            case Seek(to):
                self._target, self._jump, self._mode = to, True, "replay" if to else "live"
            case Pause():
                self._mode = "paused"
                self._jump = True
            case Play():
                if self._mode == "paused":
                    self._target = self._last.position if self._last else None
                    self._mode, self._jump = ("replay" if self._target else "live"), True
        self._rouse()

    def _rouse(self) -> None:
        """Let the session's task look what is to be done."""
        self._up_to_date = False
        self.wake.set()

    def _on_news(self) -> None:
        """Something has changed; a packet that follows the newest one is passed on if nothing is in the way."""
        newest = self._hub.newest
        if self._up_to_date and newest is not None and self._live == newest.number - 1 and not self._is_flight_full():
            frame = newest.framed(self._levels.levels)
            if self._transport.offer(frame):
                self._last, self._live = newest, newest.number
                self._account(frame)
                return
        self._rouse()

    async def run(self) -> None:
        """Feed the viewer until it leaves.

        Raises:
            SessionError: the connection is to be closed with its code.
        """
        events = self._stream.listen()
        self._hub.listeners.add(self._on_news)
        self._stream.viewers += 1
        self._stream.counters.joins += 1
        _LOG.info("stream %s: viewer %s (%s) joins", self._stream.spec.id, self.id, self.client)
        try:
            await self._send(self._welcome())
            while True:
                self.wake.clear()
                while not events.empty():
                    await self._send(events.get_nowait())
                if self._stream.deleted:
                    raise SessionError(DONE, "the stream was deleted")
                if self.draining:
                    raise SessionError(STOPPING, "the server is stopping; connect again")
                if not await self._step():
                    await self._idle()
        finally:
            self._stream.viewers -= 1
            self._hub.listeners.discard(self._on_news)
            self._stream.unlisten(events)
            seconds = time.monotonic() - self._begun
            _LOG.info("stream %s: viewer %s left after %.1f s, %d bytes", self._stream.spec.id, self.id, seconds,
                      self._sent)  # fmt: skip

    async def _idle(self) -> None:
        now = time.monotonic()
        wait = _TICK_SECONDS
        if self._free_at > now:
            wait = min(wait, self._free_at - now)
        if self._mode == "replay" and self._replay:
            wait = min(wait, max(0.0, self._due(self._replay[0]) - now))
        timer = asyncio.get_running_loop().call_later(wait, self.wake.set)
        try:
            await self.wake.wait()
        finally:
            timer.cancel()
            self._up_to_date = False

    async def _step(self) -> bool:
        """Send the next thing; whether there was anything."""
        now = time.monotonic()
        if self._stream.newest is None:
            return False
        if self._jump:
            await self._begin()
            return True
        if self._tell_levels:
            self._tell_levels = False
            await self._send(event("levels", levels=self._shown_levels, reason="requested"))
        if self._mode == "paused" or now < self._free_at or self._too_much_in_flight(now):
            return False
        if now - self._windowed_at >= _TICK_SECONDS and self._stream.window is not None:
            self._windowed_at = now
            await self._send(event("window", **self._stream.window))
        return await (self._step_live(now) if self._mode == "live" else self._step_replay(now))

    async def _begin(self) -> None:
        """Answer hello, seek, pause or play with a position, and start over from there."""
        newest, oldest = self._stream.newest, self._stream.bus.oldest
        assert newest is not None
        self._jump, clamped = False, False
        place = self._last.position if self._mode == "paused" and self._last else newest
        if self._mode != "paused":
            self._live, self._told_caught_up = None, False
            self._replay.clear()
        if self._mode == "replay" and self._target is not None:
            place = max(min(self._target, newest), oldest or newest)
            clamped = place != self._target
            if place == newest:
                self._mode = "live"
        await self._send(event("position", mode=self._mode, **place.to_json(), clamped=clamped))
        if self._mode == "replay":
            await self._load(place)

    async def _step_live(self, now: float) -> bool:
        newest = self._hub.newest
        assert newest is not None
        if self._live is None:
            await self._join()
            return True
        if self._live == newest.number:
            self._held_seconds = 0.0
            if not self._told_caught_up:
                self._told_caught_up = True
                await self._send(event("caught_up"))
            if self._levels.levels < (self._stream.levels or 1) and self._levels.may_raise(now):
                await self._raise_level(now)
                return True
            self._up_to_date = not self._throttle.bounded
            return False
        following = self._hub.window.after(self._live)
        if following is not None and now - following.arrived <= self._limits.viewer_lag_seconds:
            self._last, self._live = following, following.number
            await self._frame(following.framed(self._levels.levels))
            return True
        await self._overtake(now)
        return True

    async def _join(self) -> None:
        """The newest keyframe, coarse levels first, and one residual from it to now."""
        last = self._shown_levels - 1
        parts = self._hub.key_parts(0, last)
        self._last, residual = await self._hub.catch_up(0, last)
        self._live = self._last.number
        for part in parts:
            await self._frame(part)
        if residual is not None:
            await self._frame(residual)

    async def _overtake(self, now: float) -> None:
        """The viewer fell behind: fewer levels, and one residual over all that it missed."""
        assert self._live is not None
        shown = self._levels.levels = self._shown_levels
        if self._held_seconds > self._limits.viewer_lag_seconds / 10:  # its own doing, not a pause of the server
            self._levels.congested(now)
            self._held_seconds = 0.0
        if self._levels.levels != shown:
            await self._send(event("levels", levels=self._levels.levels, reason="congestion"))
        self._stream.counters.skips += 1
        if not self._hub.can_skip(self._live):
            self._live = None
            return
        before = self._last
        self._last, residual = await self._hub.skip(self._live, self._levels.levels)
        self._live = self._last.number
        if before is not None:
            limits = {"from": before.position.version, "to": self._last.position.version}
            await self._send(event("skipped", **limits, reason="congestion"))
        await self._frame(residual)

    async def _raise_level(self, now: float) -> None:
        """One level more: its part of the keyframe, and what has happened to it since."""
        first = self._levels.levels
        self._levels.raise_level(now)
        last = self._shown_levels - 1
        parts = self._hub.key_parts(first, last)
        _, residual = await self._hub.catch_up(first, last)
        await self._send(event("levels", levels=self._shown_levels, reason="recovered"))
        for part in parts:
            await self._frame(part)
        if residual is not None:
            await self._frame(residual)

    async def _step_replay(self, now: float) -> bool:
        if not self._replay:
            await self._load_more()
            return bool(self._replay) or self._mode == "live"
        packet = self._replay[0]
        due = self._due(packet)
        if due - now > _LONGEST_GAP_SECONDS or now - due > _LONGEST_GAP_SECONDS:
            self._clock += now - due
        elif due > now:
            return False
        self._replay.popleft()
        await self._past_packet(packet)
        return True

    async def _load(self, place: Position) -> None:
        """From the keyframe before `place` up to it; what precedes `place` is due at once."""
        bus = self._stream.bus
        key = bus.key_before(place)
        packets = await bus.read(key, place) if key else []
        while packets and not packets[0].is_key:
            packets.pop(0)
        if packets:
            self._clock = time.monotonic() - packets[-1].info.time_ns / 1e9
            for packet in packets:
                await self._past_packet(packet)

    async def _load_more(self) -> None:
        """The next versions of the past, or the change to live where it ends."""
        assert self._last is not None
        here, bus = self._last.position, self._stream.bus
        packets = await bus.read(
            Position(here.epoch, here.version + 1), Position(here.epoch, here.version + _CHUNK_VERSIONS)
        )
        if not packets or not packets[0].follows(here):
            key = bus.key_after(here)
            packets = await bus.read(key, key) if key else []
            packets = packets[-1:]
        self._replay.extend(packets)
        if not self._replay:
            newest = self._hub.newest
            self._mode = "live"
            same = newest is not None and newest.info.keyframe == self._last.info.keyframe
            self._live = newest.number if newest is not None and same and newest.position == here else None

    @property
    def _shown_levels(self) -> int:
        return min(self._levels.levels, self._stream.levels or 1)

    def _due(self, packet: StreamPacket) -> float:
        return self._clock + packet.info.time_ns / 1e9

    def _too_much_in_flight(self, now: float) -> bool:
        self._full = self._is_flight_full()
        if not self._full:
            return False
        if self._acked_at is not None and now - self._acked_at > self._limits.stuck_seconds:
            raise SessionError(BUSY, f"nothing was acknowledged for {self._limits.stuck_seconds:g} s")
        self._held_seconds += _TICK_SECONDS
        return True

    def _is_flight_full(self) -> bool:
        """Whether more is unacknowledged than a viewer may leave so; one that never acknowledges is not asked."""
        if self._acked_at is None or self._sent - self._acked <= self._limits.flight_bytes:
            return False
        key = self._hub.keyframe
        return self._sent - self._acked > self._limits.flight_bytes + (len(key.data) if key else 0)

    async def _past_packet(self, packet: StreamPacket) -> None:
        self._last = packet
        await self._frame(binary_frame(packet.restricted(self._levels.levels)))

    async def _frame(self, frame: bytes) -> None:
        begin = time.monotonic()
        await self._transport.binary(frame)
        now = time.monotonic()
        self._held_seconds += now - begin
        self._free_at = now + self._throttle.spend(self._account(frame), now)

    def _account(self, frame: bytes) -> int:
        """Count a frame that was sent; the size of its packet."""
        size = len(frame) - _overhead(len(frame))
        self._sent += size
        self._count(size)
        return size

    def _count(self, size: int) -> None:
        """Bytes that left for this viewer."""
        self._stream.counters.sent_bytes += size

    async def _send(self, message: dict[str, Any]) -> None:
        await self._transport.text(json.dumps(message))

    def _welcome(self) -> dict[str, Any]:
        stream = self._stream
        scene, newest = stream.hub.scene, stream.newest
        return {
            "type": "welcome",
            "version": 1,
            "session": self.id,
            "stream": stream.spec.id,
            "state": stream.state,
            "detail": stream.detail,
            "epoch": newest.epoch if newest else None,
            "levels": stream.levels,
            "fps": scene.header.fps if scene else None,
            "window": stream.window,
            "ack_every": _ACK_EVERY,
            "server_time_ns": time.time_ns(),
        }


def _throttle(kilobytes_per_second: float | None) -> Throttle:
    return Throttle(None if kilobytes_per_second is None else kilobytes_per_second * 1000)


def _overhead(frame_bytes: int) -> int:
    """Length of the websocket header of a frame of that total length."""
    return 2 if frame_bytes < 128 else 4 if frame_bytes < (1 << 16) + 4 else 10
