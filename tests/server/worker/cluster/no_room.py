"""A cluster that is full, for tests of what is said about it; loads little."""

from __future__ import annotations

from multiprocessing.connection import Connection

from streamlod.server.worker.messages import Sender, Tag


def find_no_room(_settings: object, _limit: int, _spec: object, pipe: Connection, *_: object) -> None:
    """Stands in for the local process of a worker, where `secret` and `stage-1` hold the cluster."""
    shortage = {"text": "it needs 1 CPU", "ways": [["secret"], ["stage-1"]]}
    Sender(pipe).send(Tag.FAILURE, {"text": "it needs 1 CPU", "fatal": True, "refused": shortage})
