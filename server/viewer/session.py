"""One viewer's session: what it asked for, and what it is sent next.

A viewer has no queue. It has a position in the hub's window or in the recording, and whenever its socket can take more,
the next packet is chosen: the following one, or one residual over everything it missed. So a slow viewer costs no more
than a socket buffer.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.protocol.messages import Ack, Control, Hello, Pause, Play, Seek, Set, event, welcome
from streamlod.server.protocol.packets import Position
from streamlod.server.protocol.presenting import Follow, Present
from streamlod.server.settings import Limits
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.description import describe
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.delivery import Delivery, Transport
from streamlod.server.viewer.follower import Follower
from streamlod.server.viewer.pacing import Allowance, LevelControl
from streamlod.server.viewer.playhead import Playhead
from streamlod.server.viewer.relay_follower import RelayFollower
from streamlod.server.viewer.replay import Replay
from streamlod.server.viewer.sound import SoundSender
from streamlod.server.viewer.together import Companion

_LOG = logging.getLogger(__name__)
_TICK_SECONDS = 1.0
_GROWN_SECONDS = 0.25  # between two window events to who is not live, while there is something new
_MAX_LEVELS = 64


class ViewerSession:
    """A viewer that has said hello.

    Args:
        stream: what it watches.
        hello: what it asked for.
        transport: its connection.
        limits: of the server.
        edges: addresses of servers that serve the same stream, for the viewer to know.
        counters: where what is sent is counted; those of the stream by default.
        on_arrival: called with the mode when the viewer is where it asked to be last: it has been told so, and
            everything up to a position of the past has been sent.
    """

    def __init__(
        self,
        stream: Stream,
        hello: Hello,
        transport: Transport,
        limits: Limits,
        *,
        edges: tuple[str, ...] = (),
        counters: Counters | None = None,
        on_arrival: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._stream, self._limits, self._edges = stream, limits, edges
        self._is_draining = False
        self.id = secrets.token_hex(6)
        self.client = hello.client
        self._end: SessionError | None = None
        self._on_arrival = on_arrival
        self.wake = asyncio.Event()
        now = time.monotonic()
        wanted = hello.levels or _MAX_LEVELS
        self._levels = LevelControl(wanted, wanted, quiet_since=now)
        rate = hello.kilobytes_per_second
        self._delivery = Delivery(transport, stream.hub, counters or stream.counters, limits, rate, self._notify)
        self._relays = hello.relay and not hello.pictures
        self._follower = (
            RelayFollower(stream, self._delivery, self._levels, limits, hello.start)
            if self._relays
            else Follower(stream, self._delivery, self._levels, limits)
        )
        transport.on_blocked(self._follower.leave_broadcast)
        self._replay = Replay(stream.bus, self._delivery, self._levels)
        self._sound = SoundSender(stream.sound_track, self._delivery, self._notify)
        self._sound.want(hello.sound)
        self._playhead = Playhead(None if self._relays else hello.start)
        self._tell_levels = False
        self._window_sent_at, self._window_sent = now, stream.newest
        self._allowance = Allowance(limits.messages_per_second, now)
        self._began_at = now
        self.companion = Companion(stream.together, self.id, self._notify, self._relays)
        if self._relays:
            self.companion.take(Follow(True))

    @property
    def position(self) -> Position | None:
        """Position of the last packet sent."""
        return self._delivery.position

    def pause(self) -> None:
        """Stay at the present position."""
        self._playhead.pause()

    @property
    def stream_id(self) -> str:
        """Identifier of the stream that is watched."""
        return self._stream.id

    def describe(self) -> dict[str, Any]:
        """VIEWER of docs/protocol.md, without its address."""
        position = self.position
        return {
            "id": self.id,
            "client": self.client,
            "seconds": time.monotonic() - self._began_at,
            "mode": self._playhead.mode,
            "position": None if position is None else position.to_json(),
            "sent_bytes": self._delivery.receiver.sent,
            "thin": False,
        }

    def drain(self) -> None:
        """Tell the viewer to go to another server; it is served until it has gone."""
        self._is_draining = True
        self._notify()

    def end(self, reason: SessionError) -> None:
        """Close the connection soon, with the reason's code."""
        self._end = reason
        self._notify()

    def on_control(self, message: Control) -> None:
        """Take a control message; it takes effect with the next step.

        Raises:
            SessionError: 4429, too many.
        """
        now = time.monotonic()
        if not self._allowance.take(now):
            raise SessionError(CloseCode.FLOOD, f"more than {self._allowance.per_second:g} messages a second")
        if isinstance(message, Ack):
            waiting = self._delivery.is_full
            self._delivery.acknowledge(message.received_bytes, now)
            if waiting or self._delivery.is_full:
                self._notify()
            return
        if isinstance(message, (Present, Follow)):
            self.companion.take(message)
            return
        self._notify()
        match message:
            case Set(levels, rate_kilobytes, given, speed, sound):
                if "levels" in given:
                    self._levels.want(levels or _MAX_LEVELS, now)
                    self._tell_levels = True
                if "kilobytes_per_second" in given:
                    self._delivery.limit_rate(rate_kilobytes)
                if "speed" in given:
                    self._replay.play_at(speed, now)
                if "sound" in given:
                    self._sound.want(sound)
            case Seek(to):
                self._playhead.seek(to)
            case Pause():
                self._playhead.pause()
            case Play():
                self._playhead.play(self._delivery.position)

    def _notify(self) -> None:
        """Leave the broadcast and wake the session's task."""
        self._follower.leave_broadcast()
        self.wake.set()

    async def run(self) -> None:
        """Send to the viewer until it leaves.

        Raises:
            SessionError: the connection is to be closed with its code.
        """
        stream = self._stream
        events = stream.listen()
        stream.hub.listeners.add(self._notify)
        stream.join()
        _LOG.info("stream %s: viewer %s (%s) joins", stream.id, self.id, self.client)
        try:
            together = self.companion.welcome()
            about = welcome(describe(stream), stream.window, self.id, stream.now_ns(), self._edges, together)
            await self._delivery.send_event(about)
            while True:
                self.wake.clear()
                while not events.empty():
                    message = events.get_nowait()
                    if message["event"] != "epoch":  # told right before the first packet of its epoch
                        await self._delivery.send_event(message)
                if stream.deleted:
                    raise SessionError(CloseCode.DONE, "the stream was deleted")
                if stream.replaced:
                    raise SessionError(CloseCode.STOPPING, "the stream began anew; connect again")
                if self._end is not None:
                    raise self._end
                if self._is_draining:
                    self._is_draining = False
                    await self._delivery.send_event(event("draining", edges=list(self._edges)))
                if (news := self.companion.news()) is not None:
                    await self._delivery.send_event(news)
                if not await self._step():
                    await self._idle()
        finally:
            stream.leave()
            self._sound.want(False)
            self.companion.leave()
            self._follower.leave_broadcast()
            stream.hub.listeners.discard(self._notify)
            stream.unlisten(events)
            seconds = time.monotonic() - self._began_at
            _LOG.info("stream %s: viewer %s left after %.1f s, %d bytes", stream.id, self.id, seconds,
                      self._delivery.receiver.sent)  # fmt: skip

    async def _idle(self) -> None:
        """Wait until there may be something to do."""
        if self._follower.is_settled:
            await self.wake.wait()
            return
        now = time.monotonic()
        wait = self._window_pause
        if self._delivery.free_at > now:
            wait = min(wait, self._delivery.free_at - now)
        if self._playhead.mode == "replay" and (due := self._replay.seconds_to_next(now)) is not None:
            wait = min(wait, due)
        full = self._delivery.is_full
        timer = asyncio.get_running_loop().call_later(wait, self._notify)
        try:
            await self.wake.wait()
        finally:
            timer.cancel()
            if full:
                self._delivery.blocked_seconds += time.monotonic() - now

    async def _step(self) -> bool:
        """Send what comes next; returns whether there was anything."""
        now = time.monotonic()
        if self._stream.newest is None:
            return False
        if self._playhead.changed:
            await self._begin()
            return True
        if self._tell_levels:
            self._tell_levels = False
            await self._delivery.send_event(event("levels", levels=self._follower.shown_levels, reason="requested"))
        await self._tell_window(now)
        if self._playhead.mode == "paused":
            return False
        played_ns = None if self._playhead.mode == "live" else self._replay.played_ns(now)
        return await self._sound.step(played_ns) or await self._go_on(now)

    @property
    def _window_pause(self) -> float:
        """Seconds between two window events; who is live is sent what is new anyway."""
        is_soon = self._playhead.mode != "live" and self._window_sent != self._stream.newest
        return _GROWN_SECONDS if is_soon else _TICK_SECONDS

    async def _tell_window(self, now: float) -> None:
        """Say what can be sought, also to who is paused."""
        if now - self._window_sent_at < self._window_pause or self._delivery.must_wait(now):
            return
        if self._stream.window is not None:
            self._window_sent_at, self._window_sent = now, self._stream.newest
            await self._delivery.send_event(event("window", **self._stream.window))

    async def _go_on(self, now: float) -> bool:
        """Send the next packet, if one is due."""
        if self._delivery.must_wait(now):
            return False
        if self._playhead.mode == "live":
            return await self._follower.step(now)
        going_on = await self._replay.step(now)
        if not self._replay.is_over or self._playhead.changed:  # the viewer may have asked for something meanwhile
            return going_on
        self._playhead.mode = "live"
        self._follower.resume()
        return True

    async def _begin(self) -> None:
        """Answer hello, seek, pause or play with a position, and continue from there."""
        newest = self._stream.newest
        assert newest is not None
        place, clamped = self._playhead.settle(self._delivery.position, self._stream.bus.oldest or newest, newest)
        mode = self._playhead.mode
        if mode != "paused":
            self._follower.restart()
            self._replay.clear()
            self._sound.restart()
        await self._delivery.send_event(event("position", mode=mode, **place.to_json(), clamped=clamped))
        if mode == "replay":
            await self._replay.load(place, lambda: not self._playhead.is_leaving)
        if not self._playhead.is_leaving:
            self._on_arrival(mode)
