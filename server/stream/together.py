"""Watching together: one viewer of a stream presents where it looks, and others follow."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from streamlod.server.protocol.presenting import Present

_MIN_SECONDS = 0.1  # between two views that followers are told; the newest counts


class Together:
    """Who presents, and what.

    Args:
        is_offered: whether anybody may.

    Attributes:
        by: session of the presenter; None without.
        shown: what it showed last, as fields of an event.
        number: counts what was shown, so that each follower knows whether it has the newest.
        watchers: called when somebody else presents, or nobody any more.
        followers: called when there is something new to see.
        forward: asks this server's origin to show what a viewer presents, which it does unless somebody else presents;
            None where this server is the origin.
        is_permitted: whether the origin lets viewers of this server present; true where this is the origin.
    """

    def __init__(self, is_offered: bool) -> None:
        self.is_offered = is_offered
        self.forward: Callable[[Present], None] | None = None
        self.is_permitted = True
        self._asked: str | None = None  # session whose view the origin was asked to show
        self.watchers: set[Callable[[], None]] = set()
        self.by: str | None = None
        self.shown: dict[str, Any] = {}
        self.number = 0
        self.followers: set[Callable[[], None]] = set()
        self._told_at = 0.0
        self._told_by: str | None = None
        self._timer: asyncio.TimerHandle | None = None

    def present(self, session: str, message: Present) -> bool:
        """Show what a viewer presents, or nothing more of it; False while somebody else presents."""
        if (self._asked or self.by) not in (None, session):
            return False
        if not message.shown:
            self.leave(session)
        elif self.forward is not None:
            self._asked = session
            self.forward(message)
        else:
            self._show(session, message.shown)
        return True

    def relay(self, by: str | None, message: Present, is_ours: bool = False) -> None:
        """Show what the origin shows, or that nobody presents there any more; `is_ours`: what it was asked to show."""
        if is_ours:
            by, message = self._asked, message if self._asked else Present(None, None)
        elif by is not None:
            self._asked = None  # somebody else was first
        if message.shown or (by, self.by) != (None, None):
            self._show(by, message.shown)

    def permit(self, is_permitted: bool) -> None:
        """The origin lets viewers of this server present, or no longer; nothing of theirs is shown there any more."""
        self.is_permitted, self._asked = is_permitted, None
        for tell in tuple(self.watchers):
            tell()

    def leave(self, session: str) -> None:
        """A viewer presents no more, if it did."""
        if self._asked == session and self.forward is not None:
            self._asked = None
            self.forward(Present(None, None))
        elif self.by == session:
            self._show(None, {})

    def _show(self, by: str | None, shown: dict[str, Any]) -> None:
        self.by, self.shown, self.number = by, shown, self.number + 1
        if self._timer is None:
            wait = max(0.0, self._told_at + _MIN_SECONDS - time.monotonic())
            self._timer = asyncio.get_running_loop().call_later(wait, self._tell)

    def _tell(self) -> None:
        self._timer, self._told_at = None, time.monotonic()
        told = self.followers if self._told_by == self.by else self.watchers
        self._told_by = self.by
        for tell in tuple(told):
            tell()
