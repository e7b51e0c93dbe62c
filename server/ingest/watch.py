"""Looks at pictures on a thread, one at a time; one that breaks is logged and was the last, and the stream goes on."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future

_log = logging.getLogger(__name__)


class Watch:
    """One watch on the pictures.

    Args:
        end: what a look that breaks puts an end to, as the beginning of a sentence.

    Attributes:
        broken: whether one broke.
    """

    def __init__(self, end: str) -> None:
        self.broken = False
        self._end = end
        self._looking: Future[None] | None = None

    def begin(self, look: Callable[[], None], pool: Executor) -> None:
        """Run `look` on a thread of `pool`, unless one still runs or broke."""
        if self.broken or (self._looking is not None and not self._looking.done()):
            return
        if self._looking is not None and (error := self._looking.exception()) is not None:
            _log.error("%s, as a look at the pictures broke", self._end, exc_info=error)
            self.broken = True
            return
        self._looking = pool.submit(look)
