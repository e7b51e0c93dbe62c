"""Tasks end though what they wait with loses a cancellation, as `asyncio.wait_for` did before Python 3.12."""

from __future__ import annotations

import asyncio

import pytest

from streamlod.server.edge.ending import end, stop_if_cancelled


async def deaf_once() -> None:
    """Loses the first cancellation."""
    try:
        await asyncio.sleep(60)
    except asyncio.CancelledError:
        await asyncio.sleep(60)


async def fails() -> None:
    raise OSError("of no interest")


def test_a_task_that_loses_a_cancellation_ends() -> None:
    async def run() -> list[bool]:
        tasks = [asyncio.create_task(work) for work in (deaf_once(), asyncio.sleep(60), fails())]
        await asyncio.sleep(0)
        await end(*tasks)
        await end()
        return [task.done() for task in tasks]

    assert asyncio.run(run()) == [True, True, True]


def test_a_loop_notices_a_lost_cancellation() -> None:
    async def goes_on() -> None:
        while True:
            stop_if_cancelled()
            try:
                await asyncio.sleep(0.01)
            except asyncio.CancelledError:
                continue

    async def run() -> None:
        task = asyncio.create_task(goes_on())
        await asyncio.sleep(0.05)
        assert not task.done()
        task.cancel()
        await asyncio.wait_for(task, 5)

    with pytest.raises(asyncio.CancelledError):
        asyncio.run(run())
