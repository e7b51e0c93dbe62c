"""Where a viewer wants to be: at the live edge, in the past, or paused. Pure state, no I/O."""

from __future__ import annotations

from streamlod.server.protocol.packets import Position


class Playhead:
    """The position and mode that a viewer asked for last.

    Args:
        start: where it begins; None is the live edge.

    Attributes:
        mode: ``live``, ``replay`` or ``paused``.
        changed: whether the viewer has yet to be told where it is.
    """

    def __init__(self, start: Position | None) -> None:
        self.seek(start)

    @property
    def is_leaving(self) -> bool:
        """Whether another place was asked for than the one that the viewer was told last."""
        return self.changed and self.mode != "paused"

    def seek(self, to: Position | None) -> None:
        """Jump; None is the live edge."""
        self._target, self.mode, self.changed = to, "replay" if to else "live", True

    def pause(self) -> None:
        """Stop at the present position."""
        self.mode, self.changed = "paused", True

    def play(self, here: Position | None) -> None:
        """Play on from `here`, the viewer's position."""
        if self.mode == "paused":
            self.seek(here)

    def settle(self, here: Position | None, oldest: Position, newest: Position) -> tuple[Position, bool]:
        """The position to go to from `here`, and whether it was clamped to the window from `oldest` to `newest`."""
        self.changed = False
        if self.mode == "paused" and here is not None:
            return here, False
        if self.mode != "replay" or self._target is None:
            return newest, False
        place = max(min(self._target, newest), oldest)
        if place == newest:
            self.mode = "live"
        return place, place != self._target
