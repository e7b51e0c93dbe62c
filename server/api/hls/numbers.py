"""Numbers of a stream's groups of pictures in its HLS playlist, ascending while groups leave at the front."""

from __future__ import annotations

from collections.abc import Sequence

from streamlod.server.protocol.packets import Position


class SegmentNumbers:
    """Remembers how many groups have left.

    Attributes:
        first: number of the oldest group.
        runs_before: encoder runs that are over before it, or within which something was deleted.
        longest: seconds of the longest group so far, as the length that a playlist names must not shrink.
    """

    def __init__(self) -> None:
        self._known: list[Position] = []
        self.first = self.runs_before = 0
        self.longest = 1.0

    def update(self, firsts: Sequence[Position], begun_ms: int, longest: float) -> None:
        """Take note of the groups that there are now.

        Args:
            firsts: of each the first position, oldest first.
            begun_ms: Unix time of the oldest, from which numbers start: as long as groups last a millisecond or more,
                they go on ascending when the server was started anew.
            longest: seconds of the longest group.
        """
        self.longest = max(self.longest, longest)
        known, self._known = self._known, list(firsts)
        if not known:
            self.first = begun_ms
            return
        gone = known.index(firsts[0]) if firsts and firsts[0] in known else len(known)
        stayed = known[gone:]
        if stayed and list(firsts[: len(stayed)]) == stayed:
            self.first += gone
            self.runs_before += len({place.epoch for place in known[: gone + 1]}) - 1
        else:  # something between was deleted: all that follows counts as new
            self.first += len(known)
            self.runs_before += len({place.epoch for place in known})
