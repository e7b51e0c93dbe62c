"""A stream of another server: pulled while somebody watches, and served on."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

from streamlod.core.errors import BitstreamError
from streamlod.server.edge.ending import end
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.origin_messages import OriginMessages, OtherStreamError
from streamlod.server.edge.supply import Supply
from streamlod.server.settings import Settings
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import Traces

_LOG = logging.getLogger(__name__)


class EdgeStream(Stream):
    """Packets are those of the origin, byte for byte, under the origin's positions and incarnation.

    An object serves for one pull. When its packets could differ from the origin's (another incarnation, packets that do
    not fit), or nobody watches any more, it asks to be replaced by a new one, which holds nothing.

    Args:
        described: what the origin says about it.
        supply: its packets.
        settings: of the server.
        feed, traces: where its states and the stages of its frames are told.
        linger_seconds: for which it is pulled after its last viewer has gone.
        replace: called when this object is of no use any more.
        remove: called when the origin has deleted the stream.

    Attributes:
        messages: what the origin's change here.
        successor: incarnation that the origin has now instead, where it said so before its list did.
    """

    successor: str | None = None

    def __init__(
        self,
        described: OriginStream,
        supply: Supply,
        settings: Settings,
        feed: Feed,
        traces: Traces,
        linger_seconds: float,
        replace: Callable[[EdgeStream], None],
        remove: Callable[[EdgeStream], None],
    ) -> None:
        super().__init__(described.id, described.incarnation, settings, supply.bus, feed, traces)
        self.messages = OriginMessages(self, supply.origin_name)
        self._supply, self._linger_seconds = supply, linger_seconds
        self._replace, self._remove = replace, remove
        self._task: asyncio.Task[None] | None = None  # the pull
        self._parting: asyncio.TimerHandle | None = None  # runs while nobody watches a stream that is pulled
        self.together.permit(False)
        self.update(described)

    @property
    def restarts(self) -> int:
        """How often the connection to the origin broke."""
        return self.messages.breaks

    def now_ns(self) -> int:
        """Unix time of the origin's clock."""
        return time.time_ns() + self.messages.clock_ahead_ns

    def update(self, described: OriginStream) -> None:
        """Take over what the origin says now; a stream that is pulled hears of its state sooner."""
        self.source, self.loop, self.created_at = described.source, described.loop, described.created_at
        before = self.sound
        self.file_sound = None if described.sound is None else described.sound.model_dump()
        self._tell_sound(before)
        self.report, self.ingest = described.report, described.ingest
        if self._task is None:
            self.progress = described.progress
            self.enter(described.state, described.detail)

    def join(self) -> None:
        """A viewer has come; the first one begins the pull."""
        super().join()
        if self._parting is not None:
            self._parting.cancel()
            self._parting = None
        if self._task is None and not self.is_over:
            self._task = asyncio.create_task(self._pull())

    def leave(self) -> None:
        """A viewer has gone; some time after the last one the pull ends."""
        super().leave()
        if not self.viewers and not self.is_over:
            loop = asyncio.get_running_loop()
            self._parting = loop.call_later(self._linger_seconds, self._replace, self)

    async def close(self) -> None:
        """End the pull."""
        if self._parting is not None:
            self._parting.cancel()
        if self._task is not None:
            await end(self._task)

    async def _pull(self) -> None:
        try:
            await self._supply.pull(self.messages)
        except OtherStreamError as error:
            self.successor = error.incarnation
            _LOG.info("stream %s: %s", self.id, error)
        except (BitstreamError, ValueError) as error:
            _LOG.warning("stream %s: the origin sent something unusable (%s); it begins anew", self.id, error)
        except Exception:
            _LOG.exception("stream %s: the pull broke; it begins anew", self.id)
        else:
            self._remove(self)
            return
        self._replace(self)
