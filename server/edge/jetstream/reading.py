"""Messages of a JetStream stream in order, from any of them on, over the loss of servers.

Each reader is a short-lived pull consumer without acknowledgements: NATS keeps nothing about a server that reads, and a
consumer that is lost with its NATS server is made again behind the last message that was read.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing, suppress
from dataclasses import dataclass

from nats.aio.msg import Msg
from nats.errors import Error
from nats.errors import TimeoutError as NoAnswerError
from nats.js.api import AckPolicy, ConsumerConfig, ConsumerInfo, DeliverPolicy
from nats.js.errors import ServiceUnavailableError

from streamlod.server.edge.ending import stop_if_cancelled
from streamlod.server.edge.jetstream.connection import REQUEST_SECONDS, NatsConnection

_BATCH = 512  # messages asked for at once
_REQUEST = {"max_bytes": 8 << 20, "expires": 5 * 10**9, "idle_heartbeat": 5 * 10**8}
_SILENT_SECONDS = 1.25  # two heartbeats and a half
_INACTIVE_SECONDS = 10.0  # after which NATS forgets a consumer
_RETRY_SECONDS = 0.25
_MAX_ASKED = 6  # for a reader: NATS never answers what it is asked in an election, which takes 4 to 9 s, or refuses it
_NO_LEADER = 10008  # code of such a refusal
_GOES_ON = {"404", "408"}  # nothing there yet; the request has expired
_NO_RESPONDERS = "503"  # servers of a cluster learn of a new consumer one after another; or it is lost
_UNHEARD_SECONDS, _MAX_UNHEARD = 0.05, 20  # between requests that nobody answers, and how many in a row
_BATCH_ENDS = {"Message Size Exceeds MaxBytes", "Batch Completed"}


@dataclass(frozen=True, slots=True)
class Selection:
    """Which messages to read.

    Attributes:
        stream: of JetStream.
        subject: with wildcards.
        headers_only: leave out the bodies.
        newest: of each subject only the newest message, and then what comes; again each time that a reader is lost.
    """

    stream: str
    subject: str
    headers_only: bool = False
    newest: bool = False


async def follow(
    connection: NatsConnection, selection: Selection, first: int, on_state: Callable[[str], None] = lambda _: None
) -> AsyncGenerator[Msg, None]:
    """Messages from sequence number `first` on, and all that come later, for ever.

    Calls `on_state` with what is wrong when they have to wait, and with nothing each time that it can read.
    """
    while True:
        stop_if_cancelled()
        try:
            async with aclosing(_consume(connection, selection, first, on_state)) as messages:
                async for message in messages:
                    yield message
                    first = message.metadata.sequence.stream + 1
        except (Error, OSError) as error:
            on_state(str(error) or "no answer")
            await asyncio.sleep(_RETRY_SECONDS)


async def read(
    connection: NatsConnection, selection: Selection, first: int, end: int | None
) -> AsyncGenerator[Msg, None]:
    """Messages from `first` on, up to `end` or what is there now.

    Raises:
        OSError: NATS does not answer, or stops to.
    """
    try:
        async with aclosing(_consume(connection, selection, first, end=end, finite=True)) as messages:
            async for message in messages:
                if end is not None and message.metadata.sequence.stream >= end:
                    return
                yield message
                if message.metadata.num_pending == 0:
                    return
    except Error as error:
        raise OSError(f"JetStream does not answer ({error})") from error


async def _consume(
    connection: NatsConnection,
    selection: Selection,
    first: int,
    on_state: Callable[[str], None] = lambda _: None,
    *,
    finite: bool = False,
    end: int | None = None,
) -> AsyncGenerator[Msg, None]:
    """Messages of one consumer, as they come.

    If it is `finite`, it ends where there are none, at once or when a request expires without one: those that were
    pending may have been discarded meanwhile.
    """
    config = ConsumerConfig(
        deliver_policy=DeliverPolicy.LAST_PER_SUBJECT if selection.newest else DeliverPolicy.BY_START_SEQUENCE,
        opt_start_seq=None if selection.newest else max(1, first),
        filter_subject=selection.subject,
        ack_policy=AckPolicy.NONE,
        headers_only=selection.headers_only,
        inactive_threshold=_INACTIVE_SECONDS,
        mem_storage=True,
        num_replicas=1,
    )
    client = connection.client
    inbox = client.new_inbox()
    answers = await client.subscribe(inbox)
    consumer = ""
    try:
        info = await _new_consumer(connection, selection.stream, config, _MAX_ASKED if finite else 1)
        consumer = info.name
        on_state("")
        if finite and not info.num_pending:
            return
        request = f"$JS.API.CONSUMER.MSG.NEXT.{selection.stream}.{consumer}"
        batch, left = _BATCH if end is None else min(_BATCH, max(1, end - first)), 0
        unheard = 0
        while True:
            if left == 0:
                left = batch
                await client.publish(request, json.dumps(_REQUEST | {"batch": batch}).encode(), inbox)
            message = await answers.next_msg(_SILENT_SECONDS)
            stop_if_cancelled()
            headers = message.headers or {}
            status = headers.get("Status")
            if status is None:
                left, unheard = left - 1, 0
                yield message
            elif status in _GOES_ON or headers.get("Description") in _BATCH_ENDS:
                if finite and left == batch and status in _GOES_ON:
                    return
                left = 0
            elif status == _NO_RESPONDERS and unheard < _MAX_UNHEARD:
                unheard, left = unheard + 1, 0
                await asyncio.sleep(_UNHEARD_SECONDS)
            elif status != "100":
                raise Error(f"the reader ended with status {status} {headers.get('Description', '')}")
    finally:
        with suppress(Error, OSError):
            await answers.unsubscribe()
            if consumer:
                await client.publish(f"$JS.API.CONSUMER.DELETE.{selection.stream}.{consumer}")


async def _new_consumer(connection: NatsConnection, stream: str, config: ConsumerConfig, tries: int) -> ConsumerInfo:
    """A consumer, asked for at most `tries` times, as long as NATS is connected and has no leader.

    NATS may have made one and lost its answer; it forgets that one, as nobody reads from it.
    """
    while True:
        try:
            return await connection.jetstream.add_consumer(stream, config)
        except (NoAnswerError, ServiceUnavailableError) as error:
            tries -= 1
            is_electing = isinstance(error, NoAnswerError) or error.err_code == _NO_LEADER
            if not tries or not is_electing or not connection.client.is_connected:
                raise
            if not isinstance(error, NoAnswerError):  # which has taken as long itself
                await asyncio.sleep(REQUEST_SECONDS)
