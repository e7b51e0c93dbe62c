"""A camera's sight of the board, and its need of it, while a walk is recorded."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardSight:
    """The board as a camera's own page tells of it.

    Attributes:
        seen: whether the camera's newest picture that was searched has the board.
        needs: where it is to be shown next, in few words; empty once the camera has seen enough.
    """

    seen: bool
    needs: str
