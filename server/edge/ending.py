"""The end of tasks that wait for another server."""

from __future__ import annotations

import asyncio
from typing import Any

_AGAIN_SECONDS = 1.0  # after which a task that has not ended is cancelled again


async def end(*tasks: asyncio.Task[Any]) -> None:
    """Cancel `tasks` and wait until they have ended, however they do.

    They are cancelled until they end: before Python 3.12 `asyncio.wait_for`, with which nats-py waits, loses a
    cancellation that comes together with what it waits for (CPython issue 81839).
    """
    left = set(tasks)
    while left:
        for task in left:
            task.cancel()
        _, left = await asyncio.wait(left, timeout=_AGAIN_SECONDS)
    await asyncio.gather(*tasks, return_exceptions=True)  # what they raised is known to be of no interest


def stop_if_cancelled() -> None:
    """Raise what a cancellation of this task raises, if one came and was lost, as `end` says.

    Raises:
        CancelledError: the task is to end.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError
