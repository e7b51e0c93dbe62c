"""A viewer's stream over any number of connections: a new one when one breaks, and where."""

from __future__ import annotations

import asyncio
import logging
import random
import ssl
from collections.abc import AsyncGenerator

from websockets.exceptions import ConnectionClosed, InvalidStatus, InvalidURI, WebSocketException

from streamlod.client.connection.address import live_address
from streamlod.client.connection.edges import at_edges, edges_of, nearest
from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.moving_link import MovingLink
from streamlod.client.events import Disconnected, Event, NewScene, Welcome
from streamlod.core.close_codes import REFUSALS, CloseCode
from streamlod.core.errors import InputError, SessionError

_log = logging.getLogger(__name__)

_LIVE = WatchOptions()
_MIN_DELAY, _MAX_DELAY = 0.5, 15.0  # seconds between attempts
_GROW_AFTER = 3  # failures; a server that is started again is found soon after it listens
_REFUSED = {401: "it needs a token", 403: "the token lacks the right", 404: "there is no such stream"}


async def watch(url: str, options: WatchOptions = _LIVE, attempts: int = 11) -> AsyncGenerator[Event, None]:
    """The events of a stream, with reconnection; ends when the server says that the stream is over.

    After a break a live viewer joins at the live edge again; a replay continues where it stopped. Where the server has
    named edges, it goes on at the nearest of them that answers, and at the server itself if that one refuses us.

    Args:
        url: of the stream's websocket, or of the page that shows it.
        attempts: failures in a row after which to give up. The very first attempt at `url` must succeed.

    Raises:
        InputError: no address of a stream, or nobody answers there.
        SessionError: the server at `url` refuses us, or breaks the protocol twice in a row.
    """
    url = live_address(url)
    failures, ever, start = 0, False, options.start
    edges: tuple[str, ...] = at_edges(url, await edges_of(url, options.token)) if options.nearest else ()
    place = await nearest(edges) or url
    while True:
        link = MovingLink(place, options)
        try:
            async for event in link.events(start):
                ever = True
                failures = 0 if isinstance(event, NewScene) else failures
                edges = at_edges(url, event.edges) if isinstance(event, Welcome) else edges
                yield event
        except (OSError, WebSocketException, SessionError) as error:
            if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code == CloseCode.DONE:
                return
            hint = "; is the server running?" if isinstance(error, OSError) else ""  # otherwise it has answered
            try:
                reason = _reason(link.url, error, repeated=failures > 0 or not ever)
            except (InputError, SessionError) as refusal:
                if link.url == url:
                    raise
                reason, edges = str(refusal), ()  # by an edge; the server itself may take us
        finally:
            await link.close()
        failures += 1
        if (not ever and link.url == url) or failures > attempts:
            raise InputError(url, f"cannot be reached ({reason}){hint}")
        if link.playback.mode == "replay" and link.playback.position is not None:
            start = link.playback.position
        edge = await nearest(each for each in edges if each != link.url)
        delay = 0.0 if edge is not None and failures == 1 else back_off(failures - 1)
        _log.warning("%s: %s; connecting again in %.1f s", link.url, reason, delay)
        yield Disconnected(reason, delay)
        await asyncio.sleep(delay)
        place = edge or url


def _reason(url: str, error: Exception, repeated: bool) -> str:
    """Why a connection ended, if another attempt makes sense; otherwise raises."""
    match error:
        case InvalidStatus() if error.response.status_code < 500:
            status = error.response.status_code
            detail = _REFUSED.get(status, "it does not want this connection")
            raise InputError(url, f"the server answered {status}: {detail}") from error
        case InvalidURI():
            raise InputError(url, "is not a websocket address") from error
        case ConnectionClosed(rcvd=close) if close is not None:
            text = f"{close.reason or 'the connection broke'} [{close.code}]"
            if close.code in REFUSALS:
                raise SessionError(close.code, f"{url} closed the connection: {close.reason}") from error
            return text
        case SessionError() if repeated:
            raise error
        case ssl.SSLCertVerificationError(verify_message=str(text)):
            trust = "for a rig's own, set SSL_CERT_FILE=rig-certificate.pem, or wherever that file lies"
            raise InputError(url, f"its certificate is not trusted ({text}); {trust}") from error
        case OSError(strerror=str(text)):
            return text
    return str(error) or "no answer"


def back_off(failures: int) -> float:
    """Seconds to wait after `failures` before: 0.5 four times, then doubled up to 15, times 0.5 to 1 at random."""
    return min(_MAX_DELAY, _MIN_DELAY * 2.0 ** min(max(failures - _GROW_AFTER, 0), 10)) * random.uniform(0.5, 1.0)
