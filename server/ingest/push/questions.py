"""Questions that capture nodes ask on the socket of their pictures, as text: the time, and which cameras are wanted.

{"type": "time", "sent": 12.5}   answered by {"type": "time", "sent": 12.5, "server_ns": 1790000000000000000}
{"type": "cameras"}              answered by {"type": "cameras", "fps": 30, "cameras": [{"name": "cam0", ...}]}
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError

_MAX_BYTES = 256  # of a question


def answer(text: str, wanted: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The answer to a question.

    Args:
        text: as it came.
        wanted: gives the rig's rate and the cameras that are pushed to it, see `Intake.wanted`.

    Raises:
        SessionError: it is no question of docs/ingest.md.
    """
    received_ns = time.time_ns()
    asked = _parsed(text)
    if asked == {"type": "cameras"}:
        return {"type": "cameras", **wanted()}
    if isinstance(asked, dict) and asked.keys() == {"type", "sent"} and asked["type"] == "time":
        sent = asked["sent"]
        if isinstance(sent, int | float) and not isinstance(sent, bool) and math.isfinite(sent):
            return {"type": "time", "sent": sent, "server_ns": received_ns}
    raise SessionError(CloseCode.BAD_MESSAGE, "a text asks for time or cameras; pictures are binary messages")


def _parsed(text: str) -> Any:
    if len(text) > _MAX_BYTES:
        raise SessionError(CloseCode.BAD_MESSAGE, f"a question has {_MAX_BYTES} bytes at most")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SessionError(CloseCode.BAD_MESSAGE, "a text is a question in JSON") from error
