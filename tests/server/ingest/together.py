"""Several threads that want the same pictures at once."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from streamlod.server.ingest.sync.picture import Picture


def load_together(pictures: Sequence[Picture], times: int) -> bool:
    """Whether two threads that load each of `pictures` so many times, at the same moments, both come back."""
    together = threading.Barrier(2)

    def load() -> None:
        for picture in pictures:
            for _ in range(times):
                together.wait(60)
                picture.load()

    threads = [threading.Thread(target=load, daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    return not any(thread.is_alive() for thread in threads)
