"""A viewer at the live edge: how it joins, follows, falls behind and recovers."""

from __future__ import annotations

from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import PIECE_BYTES, BinaryMessage, StreamPacket
from streamlod.server.settings import Limits
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.delivery import Delivery
from streamlod.server.viewer.pacing import LevelControl

_REFRESH_SHARE = 0.5  # share of the time that a viewer may lag, in which a refresh keyframe is sent
_MIN_INTERVAL = 0.01  # seconds between its pieces: 26 Mbit/s at most


class Follower:
    """Follows the hub for one viewer.

    In the ordinary case the viewer is up to date and its write buffer is empty: then it is in the hub's broadcast and
    gets new packets without its task being woken.

    Args:
        stream: what is followed.
        delivery: sends to the viewer.
        levels: how many levels it gets.
        limits: of the server.
    """

    def __init__(self, stream: Stream, delivery: Delivery, levels: LevelControl, limits: Limits) -> None:
        self._stream, self._hub, self._delivery = stream, stream.hub, delivery
        self._levels, self._limits = levels, limits
        self._sequence: int | None = None  # of the newest packet sent from the hub
        self._told_caught_up = False

    @property
    def shown_levels(self) -> int:
        """Levels that packets hold for this viewer."""
        return min(self._levels.levels, self._stream.levels or 1)

    def restart(self) -> None:
        """Join again with the next step."""
        self._sequence, self._told_caught_up = None, False

    def resume(self) -> None:
        """Go on from the last packet replayed if that is the hub's newest; otherwise join again."""
        newest, last = self._hub.newest, self._delivery.last
        self._sequence = None
        if newest is not None and last is not None and newest.position == last.position:
            self._sequence = newest.sequence if newest.info.keyframe == last.info.keyframe else None

    @property
    def is_settled(self) -> bool:
        """Whether the viewer is in the broadcast and gets all levels it wants, so that no timer is needed."""
        return self._delivery.receiver.levels > 0 and not self._wants_more

    @property
    def _wants_more(self) -> bool:
        return self._levels.levels < min(self._levels.wanted, self._stream.levels or 1)

    def leave_broadcast(self) -> None:
        """Leave the broadcast; what was sent by it counts as sent."""
        receiver, newest = self._delivery.receiver, self._hub.newest
        if receiver.levels and newest is not None:
            self._hub.remove_receiver(receiver)
            self._sequence, self._delivery.last = newest.sequence, newest

    async def step(self, now: float) -> bool:
        """Send what comes next; returns whether there was anything."""
        newest = self._hub.newest
        assert newest is not None
        if self._sequence is None:
            await self._join()
            return True
        if self._sequence == newest.sequence:
            return await self._when_up_to_date(now)
        following = self._hub.window.after(self._sequence)
        if following is not None and following.is_key:
            await self._send_refresh(following)
            return True
        if following is not None and now - following.arrived <= self._limits.viewer_lag_seconds:
            self._sequence = following.sequence
            await self._delivery.send(following.message(self._levels.levels), following)
            return True
        await self._skip_ahead(now)
        return True

    async def _when_up_to_date(self, now: float) -> bool:
        """The viewer has everything: tell it once, try one more level, or join the broadcast."""
        self._delivery.blocked_seconds = 0.0
        if not self._told_caught_up:
            self._told_caught_up = True
            await self._delivery.send_event(event("caught_up"))
        if self._wants_more and self._levels.may_raise(now):
            await self._raise_level(now)
            return True
        if self._delivery.can_post:
            self._hub.add_receiver(self._delivery.receiver, self._levels.levels)
        return False

    async def _join(self) -> None:
        """Send the newest keyframe, coarse levels first, and one residual from it to the newest state."""
        last = self.shown_levels - 1
        parts = self._hub.key_parts(0, last)
        newest, residual = await self._hub.catch_up(0, last)
        self._sequence = newest.sequence
        self._delivery.last = newest
        await self._delivery.enter(newest.position.epoch)
        await self._send_parts(parts, residual)

    async def _send_refresh(self, keyframe: StreamPacket) -> None:
        """Send a refresh keyframe in pieces.

        They are sent so fast that, on a good connection, what came meanwhile can follow packet by packet.
        """
        scene = self._hub.scene
        assert scene is not None
        message = keyframe.message(self.shown_levels)
        pieces = -(-len(message.data) // PIECE_BYTES)
        fast = max(_REFRESH_SHARE * self._limits.viewer_lag_seconds / pieces, _MIN_INTERVAL)
        await self._delivery.send(message, keyframe, min(1 / scene.header.fps, fast))
        self._sequence, self._delivery.blocked_seconds = keyframe.sequence, 0.0

    async def _skip_ahead(self, now: float) -> None:
        """The viewer fell behind: send fewer levels, and one residual over everything that it missed."""
        assert self._sequence is not None
        shown = self._levels.levels = self.shown_levels
        if self._delivery.blocked_seconds > self._limits.viewer_lag_seconds / 10:  # not the server's fault
            self._levels.congested(now)
            self._delivery.blocked_seconds = 0.0
        if self._levels.levels != shown:
            await self._delivery.send_event(event("levels", levels=self._levels.levels, reason="congestion"))
        self._stream.counters.skips += 1
        if not self._hub.can_skip_from(self._sequence):
            self._sequence = None
            assert self._hub.newest is not None
            await self._tell_skipped(self._hub.newest)
            return
        newest, residual = await self._hub.skip(self._sequence, self._levels.levels)
        self._sequence = newest.sequence
        await self._tell_skipped(newest)
        await self._delivery.send(residual, newest)

    async def _tell_skipped(self, newest: StreamPacket) -> None:
        """Say that versions up to the newest are not sent one by one; another epoch says so itself."""
        before = self._delivery.position
        if before is not None and before.epoch == newest.position.epoch:
            limits = {"from": before.version, "to": newest.position.version}
            await self._delivery.send_event(event("skipped", **limits, reason="congestion"))

    async def _raise_level(self, now: float) -> None:
        """Send one more level: its part of the keyframe, and the residual from there to the newest state."""
        first = self._levels.levels
        self._levels.raise_level(now)
        last = self.shown_levels - 1
        parts = self._hub.key_parts(first, last)
        _, residual = await self._hub.catch_up(first, last)
        await self._delivery.send_event(event("levels", levels=self.shown_levels, reason="recovered"))
        await self._send_parts(parts, residual)

    async def _send_parts(self, parts: list[BinaryMessage], residual: BinaryMessage | None) -> None:
        """Send parts of the keyframe, and the residual from it, if one is needed."""
        for message in parts if residual is None else [*parts, residual]:
            await self._delivery.send(message)
