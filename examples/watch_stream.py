"""Watch a live stream: python examples/watch_stream.py ws://127.0.0.1:8000/v1/streams/main/live picture.png

Ends at the stream's fifth state, of which it keeps a picture as the rig's first camera would see it.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import aclosing
from pathlib import Path

from streamlod import NewScene, Splatter, Welcome, camera_named, watch, write_png


async def main(url: str, out: str) -> None:
    seen = 0
    async with aclosing(watch(url)) as events:
        async for event in events:
            if isinstance(event, Welcome):
                print(f"stream {event.stream} is {event.state}")
            elif isinstance(event, NewScene):
                seen += 1
                print(f"version {event.scene.version}: {event.info.size_bytes} bytes")
                if seen == 5:
                    camera = camera_named(event.scene.header, event.scene.header.cameras[0].name)
                    write_png(Path(out), Splatter().picture(event.scene, camera, event.levels))
                    return


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
