"""Looks at pictures on a thread, one at a time; one that breaks is logged and was the last, and the stream goes on."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future, wait

_log = logging.getLogger(__name__)


class Watch:
    """One watch on the pictures.

    Args:
        end: what a look that breaks puts an end to, as the beginning of a sentence.
        on_break: called on the look's thread where one broke.
    """

    def __init__(self, end: str, on_break: Callable[[], object]) -> None:
        self._end, self._on_break = end, on_break
        self._looking: Future[None] | None = None
        self._broken = False

    def begin(self, look: Callable[[], None], pool: Executor) -> bool:
        """Run `look` on a thread of `pool` and return True, unless one still runs or broke."""
        if self._broken or (self._looking is not None and not self._looking.done()):
            return False
        self._looking = pool.submit(self._run, look)
        return True

    def finish(self) -> bool:
        """Wait for the last look; whether none broke."""
        if self._looking is not None:
            wait([self._looking])
        return not self._broken

    def _run(self, look: Callable[[], None]) -> None:
        try:
            look()
        except Exception:  # whatever is wrong with a look, the stream goes on
            self._broken = True
            self._on_break()
            _log.exception("%s, as a look at the pictures broke", self._end)
