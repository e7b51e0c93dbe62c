"""Live sound that reaches a running server as its worker's does."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable

from streamlod.codec.mp4.sound import SoundPiece, pack_piece
from streamlod.codec.sound.encoder import SoundEncoder
from streamlod.codec.sound.opus import SAMPLE_RATE
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.messages import Tag
from tests.clicks import clicks
from tests.server.conftest import Running


def pieces(seconds: float, begin_ns: int = 0, channels: int = 1) -> list[SoundPiece]:
    """Pieces of a click at each whole second of the clock."""
    encoder = SoundEncoder(channels)
    first = round(begin_ns * SAMPLE_RATE / 1e9)
    packets = encoder.put(clicks(seconds, channels=channels, begin=begin_ns / 1e9 % 1.0), first)
    return [SoundPiece(encoder.settings, tuple(packets[at : at + 10])) for at in range(0, len(packets), 10)]


def hear(server: Running, found: Iterable[SoundPiece], name: str = "main", camera: str | None = None) -> None:
    """Hand pieces, heard at `camera` if at one, to a stream, on the loop of its server."""
    stream = server.registry.streams[name]
    assert isinstance(stream, WorkerStream)

    async def tell() -> None:
        await stream.work.on_message(Tag.MICROPHONE, json.dumps({"camera": camera}).encode())
        for piece in found:
            await stream.work.on_message(Tag.SOUND, pack_piece(piece))

    asyncio.run_coroutine_threadsafe(tell(), server.loop).result(30)
