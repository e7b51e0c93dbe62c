"""Who joins in the moment in which an epoch begins knows which one it is."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.process import Tag
from tests.server.conftest import Clip


def test_joining_while_the_first_packet_of_an_epoch_is_decoded(clip: Clip) -> None:
    """Welcomed before it is the newest, one is told of its epoch afterwards; welcomed after, one is not told again."""

    async def run() -> None:
        stream = WorkerStream(StreamSpec(job=TrainJob(data=Path("fed by hand"))), Settings())
        for epoch in (1, 2):
            await stream.on_message(Tag.EPOCH, b"")
            free = threading.Event()
            stream.hub._thread.submit(free.wait)  # decoding has to wait its turn
            feeding = asyncio.create_task(stream.on_message(Tag.PACKET, clip.packets[0]))
            await asyncio.sleep(0.05)
            early, welcomed = stream.listen(), stream.describe()["epoch"]
            assert welcomed == (None if epoch == 1 else 1)
            assert early.empty()
            free.set()
            await feeding
            assert early.get_nowait() == {"type": "event", "event": "epoch", "epoch": epoch}
            late = stream.listen()
            assert stream.describe()["epoch"] == epoch
            await stream.on_message(Tag.PACKET, clip.packets[1])
            told = [late.get_nowait()["event"] for _ in range(late.qsize())]
            assert "epoch" not in told

    asyncio.run(run())
