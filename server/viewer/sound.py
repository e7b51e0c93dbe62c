"""Live sound for one viewer that asks for it: what belongs to the pictures that it has, and a little more."""

from __future__ import annotations

from collections.abc import Callable

from streamlod.server.stream.sound_track import SoundTrack
from streamlod.server.viewer.delivery import Delivery

_AHEAD_NS = 4_000_000_000  # of what a replay plays
_LOW_NS = 2_000_000_000  # less than that is sent ahead: it is time for more


class SoundSender:
    """Sends a viewer the sound of its stream from the time of its picture on.

    At the live edge that is all there is, as sound comes before its picture has been trained; in a replay, some
    seconds ahead.

    Args:
        track: of the stream.
        delivery: sends to the viewer.
        notify: wakes the viewer's session.
    """

    def __init__(self, track: SoundTrack, delivery: Delivery, notify: Callable[[], None]) -> None:
        self._track, self._delivery, self._notify = track, delivery, notify
        self._until_ns: int | None = None
        self._is_wanted = False

    def want(self, wanted: bool) -> None:
        """Begin to send sound, or end it."""
        self._is_wanted, self._until_ns = wanted, None
        (self._track.listeners.add if wanted else self._track.listeners.discard)(self._notify)

    def restart(self) -> None:
        """Go on from the next picture, wherever that is."""
        self._until_ns = None

    async def step(self, played_ns: int | None) -> bool:
        """Send what is due; returns whether there was anything.

        Args:
            played_ns: the time up to which a replay has come, or None at the live edge.
        """
        shown = self._delivery.last
        if not self._is_wanted or shown is None:
            return False
        begin_ns = shown.info.time_ns if self._until_ns is None else self._until_ns
        end_ns = None if played_ns is None else played_ns + _AHEAD_NS
        if played_ns is not None:
            begin_ns = max(begin_ns, played_ns - _LOW_NS)  # a replay may have leapt over a gap
        if end_ns is not None and end_ns - begin_ns < _AHEAD_NS - _LOW_NS:
            return False
        found = await self._track.read(begin_ns, end_ns)
        for each in found:
            await self._delivery.send_sound(each.message)
        if found:
            self._until_ns = found[-1].piece.end_ns - 1
        elif end_ns is not None:
            self._until_ns = end_ns  # there is none
        return bool(found)
