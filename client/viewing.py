"""Watch a live stream and record what a viewpoint sees of it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import aclosing
from pathlib import Path

from client.connection.link import WatchOptions
from client.connection.watch import watch
from client.events import Event, NewScene, Notice, Welcome
from client.recorder import Recorder, open_recorder
from client.viewpoints import CameraPath
from core.errors import InputError
from core.render.splatter import Splatter
from core.scene.anchors import SceneHeader

_log = logging.getLogger(__name__)
_QUIET_SECONDS = 2.0  # a stream that has ended is over when no packet comes for so long
_DEFAULT_FPS = 30.0

Tell = Callable[[str], None]


async def record_stream(
    url: str,
    out: Path,
    viewpoint: Callable[[SceneHeader], CameraPath],
    frames: int | None = None,
    options: WatchOptions | None = None,
    tell: Tell = lambda text: None,
) -> int:
    """Record one picture for each packet that arrives, until there are `frames` pictures or the stream is over.

    If the viewpoint moves, it finishes its path around the last scene when the stream is over.

    Args:
        viewpoint: makes the path of the camera once the scene's header is known.
        tell: called with short texts about the progress.

    Returns:
        Number of pictures.

    Raises:
        InputError: no server answers, the viewpoint does not exist, or nothing could be recorded.
        SessionError: the server refuses us or breaks the protocol.
    """
    take = _Take(out, viewpoint, tell)
    try:
        async with aclosing(watch(url, options or WatchOptions())) as events:
            while frames is None or take.count < frames:
                try:
                    async with asyncio.timeout(_QUIET_SECONDS if take.is_over else None):
                        event = await anext(events)
                except (StopAsyncIteration, TimeoutError):
                    break
                await take.handle(event)
    except BaseException as error:
        take.close(error)
        raise
    while take.newest is not None and frames is not None and take.count < frames and take.moves():
        await take.draw(take.newest)
    take.close(None)
    if take.count == 0:
        raise InputError(url, "the stream ended before it had a picture")
    return take.count


class _Take:
    """A recording in progress."""

    def __init__(self, out: Path, viewpoint: Callable[[SceneHeader], CameraPath], tell: Tell) -> None:
        self._out, self._viewpoint, self._tell = out, viewpoint, tell
        self._splatter = Splatter()
        self._recorder: Recorder | None = None
        self._path: CameraPath | None = None
        self.newest: NewScene | None = None
        self.count = 0
        self._ended = False

    @property
    def is_over(self) -> bool:
        """Whether the stream has ended and its last scene is here."""
        return self._ended and self.newest is not None

    def moves(self) -> bool:
        """Whether the next picture would be taken from another viewpoint than the last one."""
        if self._path is None:
            return False
        before, after = self._path(self.count - 1), self._path(self.count)
        return bool((before.world_to_camera != after.world_to_camera).any())

    async def handle(self, event: Event) -> None:
        """Draw a new scene; report other events."""
        if isinstance(event, NewScene):
            await self.draw(event)
        elif isinstance(event, Welcome):
            self._ended = event.state == "ended"
            self._tell(f"{event.stream} is {event.state}")
        elif isinstance(event, Notice) and event.name == "state":
            self._ended = event.fields.get("state") == "ended"
            if event.fields.get("state") == "failed":
                raise InputError("stream", f"has failed: {event.fields.get('detail', '')}")
            self._tell(f"stream is {event.fields.get('state')}")
        elif isinstance(event, Notice) and event.name == "progress":
            self._tell(f"first frame {100 * float(event.fields.get('fraction') or 0):.0f} %")

    async def draw(self, event: NewScene) -> None:
        """One picture of the scene, from the path's next camera."""
        self.newest = event
        header = event.scene.header
        if self._path is None or self._recorder is None:
            self._path = self._viewpoint(header)
            self._recorder = open_recorder(self._out, header.fps or _DEFAULT_FPS)
            self._recorder.__enter__()
        camera = self._path(self.count)
        picture = await asyncio.to_thread(self._splatter.picture, event.scene, camera, event.levels)
        self._recorder.add(picture)
        self.count += 1
        self._tell(f"picture {self.count}, version {event.scene.version}")

    def close(self, error: BaseException | None) -> None:
        """Complete the recording, or discard it after an error."""
        if self._recorder is not None:
            keep = error is None or isinstance(error, KeyboardInterrupt | asyncio.CancelledError)
            self._recorder.__exit__(*((None, None, None) if keep or error is None else (type(error), error, None)))
