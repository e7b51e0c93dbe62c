"""Questions to many devices at the same time, of which some may never answer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence


def at_once(works: Sequence[Callable[[], object]], seconds: float) -> None:
    """Run each of `works` on a thread of its own, and wait for all, so long at most; those that hang are left behind.

    Args:
        works: note what they find themselves, and raise nothing.
    """
    threads = [threading.Thread(target=work, daemon=True, name="finding") for work in works]
    for thread in threads:
        thread.start()
    end = time.monotonic() + seconds
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
