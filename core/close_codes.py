"""Close codes of the websocket protocols, with which either side says why it leaves: docs/protocol.md, section 1.

Here, below the server and the client, as both use them; the page has its own copy in `client/web/stream/session.js`.
"""

from __future__ import annotations

from enum import IntEnum


class CloseCode(IntEnum):
    """Why a connection ends; those from 1000 to 1013 as in RFC 6455 section 7.4.1."""

    DONE = 1000
    STOPPING = 1001
    POLICY = 1008
    TOO_BIG = 1009
    FAULT = 1011
    BUSY = 1013
    BAD_MESSAGE = 4400
    UNAUTHORISED = 4401
    FORBIDDEN = 4403
    NO_STREAM = 4404
    HELLO_TIMEOUT = 4408
    BAD_VERSION = 4415
    FLOOD = 4429


REFUSALS = frozenset(
    {
        CloseCode.POLICY,
        CloseCode.TOO_BIG,
        CloseCode.BAD_MESSAGE,
        CloseCode.UNAUTHORISED,
        CloseCode.FORBIDDEN,
        CloseCode.NO_STREAM,
        CloseCode.BAD_VERSION,
    }
)  # another attempt would end in the same way
