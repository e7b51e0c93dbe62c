"""What a worker's messages change in its stream: the epoch that viewers know, and the state that they see."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path
from typing import Any

from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.description import describe
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.messages import Tag
from tests.server.conftest import Clip
from tests.server.figures import figures


def test_a_stream_is_degraded_while_a_camera_is_lost(clip: Clip) -> None:
    async def run() -> None:
        stream = WorkerStream(StreamSpec(job=TrainJob(live={})), Settings())
        await stream.work.resume_point()

        async def tell(told: dict[str, Any]) -> tuple[str, str]:
            await stream.work.on_message(Tag.INGEST, json.dumps(told).encode())
            assert describe(stream)["ingest"] == told
            return stream.state, stream.detail

        lost = figures(CameraState.LOST, "Connection refused")
        stream.enter("starting")
        assert await tell(lost) == ("starting", "camera cam1 is lost (Connection refused)")
        assert await tell(figures()) == ("starting", "")
        await stream.work.on_message(Tag.PACKET, clip.packets[0])
        assert stream.state == "live"
        assert await tell(lost) == ("degraded", "camera cam1 is lost (Connection refused)")
        await stream.work.on_message(Tag.PACKET, clip.packets[1])
        assert stream.state == "degraded"
        assert await tell(figures(CameraState.LATE)) == ("live", "")
        state, detail = await tell(figures(knocked=True))
        assert (state, detail[:24]) == ("degraded", "camera cam0 was knocked:")
        assert await tell(figures()) == ("live", "")
        await stream.work.resume_point()  # the worker died
        stream.enter("degraded", "the worker ended by signal 9; it is being restarted")
        assert await tell(figures()) == ("degraded", "the worker ended by signal 9; it is being restarted")

    asyncio.run(run())


def test_who_joins_while_the_first_packet_of_an_epoch_is_decoded_is_told_which_one(clip: Clip) -> None:
    """Welcomed before it is the newest, one is told of its epoch afterwards; welcomed after, one is not told again."""

    async def run() -> None:
        stream = WorkerStream(StreamSpec(job=TrainJob(data=Path("fed by hand"))), Settings())
        for epoch in (1, 2):
            await stream.work.on_message(Tag.EPOCH, b"")
            free = threading.Event()
            stream.hub._thread.submit(free.wait)  # decoding has to wait its turn
            feeding = asyncio.create_task(stream.work.on_message(Tag.PACKET, clip.packets[0]))
            await asyncio.sleep(0.05)
            early, welcomed = stream.listen(), describe(stream)["epoch"]
            assert welcomed == (None if epoch == 1 else 1)
            assert early.empty()
            free.set()
            await feeding
            assert early.get_nowait() == {"type": "event", "event": "epoch", "epoch": epoch}
            late = stream.listen()
            assert describe(stream)["epoch"] == epoch
            await stream.work.on_message(Tag.PACKET, clip.packets[1])
            told = [late.get_nowait()["event"] for _ in range(late.qsize())]
            assert "epoch" not in told

    asyncio.run(run())
