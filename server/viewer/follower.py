"""A viewer at the live edge: how it joins, follows, falls behind and recovers."""

from __future__ import annotations

from server.protocol.messages import event
from server.protocol.packets import StreamPacket
from server.settings import Limits
from server.stream.stream import Stream
from server.viewer.delivery import Delivery
from server.viewer.pacing import LevelControl


class Follower:
    """A place in the hub's window, and what follows from there.

    A viewer that is up to date and whose socket is empty gets new packets by its lane, without its task being woken:
    that is the ordinary case.

    Args:
        stream: what is followed.
        delivery: the way to the viewer.
        levels: how many it gets.
        limits: of the server.
    """

    def __init__(self, stream: Stream, delivery: Delivery, levels: LevelControl, limits: Limits) -> None:
        self._stream, self._hub, self._delivery = stream, stream.hub, delivery
        self._levels, self._limits = levels, limits
        self._number: int | None = None  # of the newest packet sent from the hub
        self._told_caught_up = False

    @property
    def shown_levels(self) -> int:
        """Levels that packets carry for this viewer."""
        return min(self._levels.levels, self._stream.levels or 1)

    def restart(self) -> None:
        """Join anew with the next step."""
        self._number, self._told_caught_up = None, False

    def resume(self) -> None:
        """Go on from the newest packet that was replayed, where it is the hub's; otherwise join anew."""
        newest, last = self._hub.newest, self._delivery.last
        self._number = None
        if newest is not None and last is not None and newest.position == last.position:
            self._number = newest.number if newest.info.keyframe == last.info.keyframe else None

    @property
    def is_content(self) -> bool:
        """Whether packets take the lane, and there is no level more to be tried after a while."""
        return self._delivery.lane.levels > 0 and not self._wants_more

    @property
    def _wants_more(self) -> bool:
        return self._levels.levels < min(self._levels.wanted, self._stream.levels or 1)

    def leave_lane(self) -> None:
        """Let nothing more take the lane; what has gone that way is accounted for."""
        lane, newest = self._delivery.lane, self._hub.newest
        if lane.levels and newest is not None:
            self._hub.leave_lane(lane)
            self._number, self._delivery.last = newest.number, newest

    async def step(self, now: float) -> bool:
        """Send the next thing; whether there was anything."""
        newest = self._hub.newest
        assert newest is not None
        if self._number is None:
            await self._join()
            return True
        if self._number == newest.number:
            return await self._rest(now)
        following = self._hub.window.after(self._number)
        if following is not None and following.is_key:
            await self._renew(following)
            return True
        if following is not None and now - following.arrived <= self._limits.viewer_lag_seconds:
            self._number = following.number
            await self._delivery.frame(following.framed(self._levels.levels), following)
            return True
        await self._overtake(now)
        return True

    async def _rest(self, now: float) -> bool:
        """The viewer has everything: say so once, or try a level more."""
        self._delivery.held_seconds = 0.0
        if not self._told_caught_up:
            self._told_caught_up = True
            await self._delivery.event(event("caught_up"))
        if self._wants_more and self._levels.may_raise(now):
            await self._raise_level(now)
            return True
        if self._delivery.can_post:
            self._hub.enter_lane(self._delivery.lane, self._levels.levels)
        return False

    async def _join(self) -> None:
        """The newest keyframe, coarse levels first, and one residual from it to now."""
        last = self.shown_levels - 1
        parts = self._hub.key_parts(0, last)
        newest, residual = await self._hub.catch_up(0, last)
        self._number = newest.number
        self._delivery.last = newest
        await self._give(parts, residual)

    async def _renew(self, keyframe: StreamPacket) -> None:
        """A new keyframe while an older one is shown: a piece a frame, then one residual over what has come since."""
        scene, levels = self._hub.scene, self.shown_levels
        assert scene is not None
        await self._delivery.trickle(keyframe, levels, 1 / scene.header.fps)
        self._number = keyframe.number
        if self._hub.keyframe is keyframe:
            newest, residual = await self._hub.catch_up(0, levels - 1)
            if residual is not None:
                self._number = newest.number
                await self._delivery.frame(residual, newest)

    async def _overtake(self, now: float) -> None:
        """The viewer fell behind: fewer levels, and one residual over all that it missed."""
        assert self._number is not None
        shown = self._levels.levels = self.shown_levels
        if self._delivery.held_seconds > self._limits.viewer_lag_seconds / 10:  # its own doing, not the server's pause
            self._levels.congested(now)
            self._delivery.held_seconds = 0.0
        if self._levels.levels != shown:
            await self._delivery.event(event("levels", levels=self._levels.levels, reason="congestion"))
        self._stream.counters.skips += 1
        if not self._hub.can_skip(self._number):
            self._number = None
            return
        before = self._delivery.last
        newest, residual = await self._hub.skip(self._number, self._levels.levels)
        self._number = newest.number
        if before is not None:
            limits = {"from": before.position.version, "to": newest.position.version}
            await self._delivery.event(event("skipped", **limits, reason="congestion"))
        await self._delivery.frame(residual, newest)

    async def _raise_level(self, now: float) -> None:
        """One level more: its part of the keyframe, and what has happened to it since."""
        first = self._levels.levels
        self._levels.raise_level(now)
        last = self.shown_levels - 1
        parts = self._hub.key_parts(first, last)
        _, residual = await self._hub.catch_up(first, last)
        await self._delivery.event(event("levels", levels=self.shown_levels, reason="recovered"))
        await self._give(parts, residual)

    async def _give(self, parts: list[bytes], residual: bytes | None) -> None:
        """Parts of the keyframe, and the residual from it, if one is needed."""
        for frame in parts if residual is None else [*parts, residual]:
            await self._delivery.frame(frame)
