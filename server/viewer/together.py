"""One viewer's part in watching together: whether it presents, and what it was told of what others present."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.presenting import Follow, Present
from streamlod.server.stream.together import Together


class Companion:
    """A viewer that may present, and may follow.

    Args:
        together: of its stream.
        session: the viewer's.
        notify: wakes the viewer's task.
        relays: whether it is another server, which is refused what it may not, but stays connected.
    """

    def __init__(self, together: Together, session: str, notify: Callable[[], None], relays: bool) -> None:
        self._together, self._session, self._notify, self._relays = together, session, notify, relays
        self._may_present = False
        self._follows = False
        self._told_number = together.number
        self._told_by = together.by
        self._told_may = False  # present; a welcome says it first
        together.watchers.add(notify)

    def permit(self, may_present: bool) -> None:
        """The viewer has the right to present, or has lost it, which ends what it presents."""
        self._may_present = may_present
        if not may_present:
            self._together.leave(self._session)
        self._notify()

    def welcome(self) -> dict[str, Any] | None:
        """The field `together` of a welcome; None where nobody may present."""
        if not self._together.is_offered:
            return None
        self._told_may = self._can_present
        return {"by": self._together.by, "may_present": self._told_may}

    def take(self, message: Present | Follow) -> None:
        """Act on a message.

        Raises:
            SessionError: 4403, the viewer may not present.
        """
        if isinstance(message, Follow):
            self._follow(message.on)
            return
        if not self._relays and not (self._may_present and self._together.is_offered):
            raise SessionError(CloseCode.FORBIDDEN, "presenting needs the right `present`, and a server that offers it")
        if not self._can_present or not self._together.present(self._session, message):
            self._told_by = ""  # so that it is told who does
            self._notify()

    @property
    def _can_present(self) -> bool:
        return self._may_present and self._together.is_offered and self._together.is_permitted

    def _follow(self, on: bool) -> None:
        together = self._together
        self._follows = on
        if on:
            together.followers.add(self._notify)
            self._told_number = -1 if together.shown else together.number
        else:
            together.followers.discard(self._notify)
        self._notify()

    def news(self) -> dict[str, Any] | None:
        """The event that the viewer has to be told now, if any: who presents, to followers what, and a new right."""
        together, may = self._together, self._can_present
        is_new_view, is_new_right = self._follows and self._told_number != together.number, self._told_may != may
        if not is_new_view and not is_new_right and self._told_by == together.by:
            return None
        self._told_number, self._told_by, self._told_may = together.number, together.by, may
        right = {"may_present": may} if is_new_right else {}
        return event("presenter", by=together.by, **right, **(together.shown if self._follows else {}))

    def leave(self) -> None:
        """The viewer goes."""
        self._together.watchers.discard(self._notify)
        self._together.followers.discard(self._notify)
        self._together.leave(self._session)
