"""Honest viewers for which the server draws: each takes one picture after another, in a thread."""

from __future__ import annotations

import threading
from contextlib import ExitStack

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from streamlod.core.camera import Camera
from tests.server.viewer.test_thin_session import ThinViewer


class ThinWatched:
    """What all of them together have seen so far.

    Attributes:
        pictures: that came.
        closed: reasons of connections that ended.
    """

    def __init__(self) -> None:
        self.pictures, self.closed = 0, list[str]()
        self._ending = threading.Event()

    def begin(self, port: int, count: int, camera: Camera, stack: ExitStack) -> None:
        """Have `count` viewers watch the stream "main" from `camera` until the stack is left."""
        threads = [threading.Thread(target=self._watch, args=(port, camera)) for _ in range(count)]
        stack.callback(lambda: [thread.join() for thread in threads])
        stack.callback(self._ending.set)
        for thread in threads:
            thread.start()

    def _watch(self, port: int, camera: Camera) -> None:
        address = f"ws://127.0.0.1:{port}/v1/streams/main/live"
        options = {"compression": None, "max_size": 2**24, "proxy": None, "max_queue": None}
        with connect(address, subprotocols=["streamlod.v1"], **options) as connection:  # type: ignore[arg-type]
            viewer = ThinViewer(connection)
            viewer.hello()
            viewer.look(camera)
            while not self._ending.is_set():
                try:
                    viewer.picture()
                except (ConnectionClosed, TimeoutError) as error:
                    self.closed.append(str(error) or type(error).__name__)
                    return
                self.pictures += 1
