"""The last state of a recording, shown by a stream whose worker has sent nothing yet."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

from streamlod.core.errors import StreamlodError
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.stream import Stream

_LOG = logging.getLogger(__name__)
MAX_AWAY_SECONDS = 60.0  # a server that was gone for longer trains its streams anew: what they film has changed


async def show_recorded(stream: Stream) -> Position | None:
    """Show the last state of a stream's recording, so that its past can be seen.

    Returns the state's position, if training may continue from there: what is filmed still looks like it.
    """
    recording = stream.bus.recording
    if recording is None or not recording.segments or stream.hub.newest is not None:
        return None
    last = recording.segments[-1]
    try:
        for packet in await stream.bus.read_group(last.first, last.last):
            stream.hub.send(await stream.hub.decode(replace(packet, sequence=stream.sequence)))
            stream.sequence += 1
        away = time.time() - last.path.stat().st_mtime
    except (StreamlodError, OSError, ValueError) as error:
        _LOG.warning("stream %s: its last state cannot be shown: %s", stream.id, error)
        return None
    return last.last if away < MAX_AWAY_SECONDS else None
