"""A server with a stream that phones film for, whose rig takes pictures in this process: nothing trains."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.core.frames import FrameSet
from streamlod.server.ingest.live import LiveDataset, open_live
from streamlod.server.settings import Settings
from tests.server.conftest import Running, running

FPS, WIDTH, HEIGHT = 20, 320, 240


def rig(size: tuple[int, int], phones: int, quorum: int = 1, **fields: object) -> dict[str, Any]:
    """Phones side by side in front of a scene."""
    width, height = size
    fixed = {"width": width, "height": height, "intrinsics": [[300, 0, width / 2], [0, 300, height / 2], [0, 0, 1]]}
    cameras = [
        {"name": f"phone{row + 1}", "source": "push:", **fixed,
         "world_to_camera": [[1, 0, 0, 0.1 * row], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}
        for row in range(phones)
    ]  # fmt: skip
    return {"fps": FPS, "policy": {"quorum": quorum}, "cameras": cameras, **fields}


@dataclass
class Stage:
    """A server whose stream `main` is fed by phones, and what its rig gives out while it films."""

    server: Running
    definition: dict[str, Any]
    got: list[FrameSet] = field(default_factory=list)
    heard: list[SoundPiece] = field(default_factory=list)
    dataset: LiveDataset = field(init=False)

    def page(self, query: str = "") -> str:
        return f"{self.server.url}/capture?stream=main{query}"

    @contextmanager
    def filming(self) -> Iterator[None]:
        """Take pictures while the context lasts."""
        dataset = self.dataset = open_live(
            self.definition,
            push_socket=self.server.registry.streams["main"].push_socket,
            give_sound=self.heard.append,
        )

        def read() -> None:
            for frames in dataset.frames():
                self.got.append(frames)

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        limit = time.monotonic() + 60
        while dataset.rig is None:
            assert time.monotonic() < limit
            time.sleep(0.01)
        try:
            yield
        finally:
            dataset.close()
            thread.join(60)
            assert not thread.is_alive()

    def wait(self, count: int) -> list[FrameSet]:
        """So many instants more."""
        self.got.clear()
        limit = time.monotonic() + 60
        while len(self.got) < count:
            assert time.monotonic() < limit, self.dataset.statistics()
            time.sleep(0.02)
        return list(self.got)[:count]


@contextmanager
def stage(settings: Settings, definition: dict[str, Any], token: str | None = None) -> Iterator[Stage]:
    """A server with the stream `main`, idle, whose rig runs here."""
    with running(settings) as server, server.client() as client:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        made = client.post("/v1/streams", json={"id": "main", "live": definition}, headers=headers)
        assert made.status_code == 201, made.text
        found = Stage(server, definition)
        with found.filming():
            yield found
