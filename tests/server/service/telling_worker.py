"""A worker that says when the stages of its frames ran, in a process of its own that loads little."""

from __future__ import annotations

import time
from multiprocessing.connection import Connection

from streamlod.codec.container import SlodReader
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker.messages import Sender, Tag, receive_resume


def work(spec: StreamSpec, pipe: Connection, *_: object) -> None:
    """A worker that plays its file and tells that each frame was filmed, trained and encoded in the 30 ms before."""
    sender = Sender(pipe)
    receive_resume(pipe)
    assert spec.play is not None
    with SlodReader(spec.play) as reader:
        for number in range(len(reader.entries)):
            now_ns = time.time_ns()
            sender.send(Tag.PACKET, reader.read(number))
            begins = [("ingest", now_ns - 30_000_000), ("train", now_ns - 20_000_000), ("encode", now_ns - 10_000_000)]
            stages = [(name, begin_ns, begin_ns + 10_000_000) for name, begin_ns in begins]
            sender.send(Tag.REPORT, {"version": number, "stages": stages})
    sender.send(Tag.END)
