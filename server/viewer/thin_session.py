"""A thin viewer, which gets pictures: an ordinary session, whose packets are decoded here, and a loop that draws.

Joining, levels, seeking, pausing and falling behind work as for every viewer; only the last step, from the decoded
state to a picture, happens here. One picture is in flight at a time, drawn for the newest view.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.limits import DecoderLimits
from streamlod.core.camera import Camera, pinhole
from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.server.protocol.messages import Control, Hello, Pause, Play, Seek, event
from streamlod.server.protocol.packets import BinaryMessage
from streamlod.server.protocol.thin_messages import Pick, Shown, ViewMessage
from streamlod.server.settings import Limits
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.delivery import Transport
from streamlod.server.viewer.grades import GRADES, GradeControl
from streamlod.server.viewer.renderer import HEADER, PictureRenderer, look_along
from streamlod.server.viewer.session import ViewerSession
from streamlod.server.viewer.together import Companion

_REST_SECONDS = 0.3  # after which a view that does not move gets a better picture
_MIN_INTERVAL_SECONDS = 0.05  # between two pictures


class _DecodingTransport:
    """The transport of the ordinary session: packets go to a decoder, events to the viewer."""

    def __init__(self, outer: Transport, changed: asyncio.Event, limits: DecoderLimits) -> None:
        self._outer, self._changed = outer, changed
        self._decoder = SceneDecoder(limits)
        self.scene: Scene | None = None
        self.levels = 0  # of the scene that are up to date, counted from the coarsest

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None:
        await asyncio.to_thread(self._decoder.push, message.data)
        self.scene, self.levels = self._decoder.scene, self._decoder.current_levels
        self._changed.set()

    async def text(self, message: str) -> None:
        await self._outer.text(message)

    def post(self, frame: bytes) -> None:
        raise AssertionError("never clear, so nothing is posted")

    @property
    def is_clear(self) -> bool:
        """Never: each packet is decoded before the next one."""
        return False

    def on_blocked(self, call: Callable[[], None]) -> None:
        """Nothing is ever posted."""


class ThinSession:
    """A viewer that said hello with `pictures`.

    Args:
        stream, hello, transport, limits, edges: as of `ViewerSession`.
        renderer: draws the pictures.
    """

    def __init__(
        self,
        stream: Stream,
        hello: Hello,
        transport: Transport,
        limits: Limits,
        renderer: PictureRenderer,
        *,
        edges: tuple[str, ...],
    ) -> None:
        self._changed = asyncio.Event()
        self._decoding = _DecodingTransport(transport, self._changed, limits.decoder)
        counters = Counters()  # packets stay in this process and are not counted as sent
        self._session = ViewerSession(
            stream, hello, self._decoding, limits, edges=edges, counters=counters, on_arrival=self._arrived
        )
        self._stream, self._limits, self._viewer, self._renderer = stream, limits, transport, renderer
        self._splatter, self._grades = Splatter(), GradeControl()
        self._camera: Camera | None = None
        self._number = self._shown = 0
        self._keyframe: Scene | None = None  # whose scene event the viewer has got
        self._picks: list[Pick] = []
        self._seeking: Seek | None = None  # on the way to its position nothing is drawn
        self._seeks = 0  # so far
        self._arrival: tuple[Scene, int] | None = None  # its state, which is shown before what follows
        self._frozen: tuple[Scene, int] | None = None  # paused: the state on screen, whatever has arrived since
        self._drawn: tuple[Scene, int, Camera] | None = None

    @property
    def id(self) -> str:
        """See `ViewerSession`."""
        return self._session.id

    @property
    def companion(self) -> Companion:
        """See `ViewerSession`."""
        return self._session.companion

    @property
    def stream_id(self) -> str:
        """See `ViewerSession`."""
        return self._stream.id

    def describe(self) -> dict[str, Any]:
        """See `ViewerSession`; bytes are those of packets, which stay in the server."""
        return self._session.describe() | {"thin": True}

    def drain(self) -> None:
        """See `ViewerSession`."""
        self._session.drain()

    def end(self, reason: SessionError) -> None:
        """See `ViewerSession`."""
        self._session.end(reason)

    def on_control(self, message: Control) -> None:
        """Take a control message.

        Raises:
            SessionError: as of `ViewerSession`.
        """
        if isinstance(message, Pause) and self._seeking is not None and self._seeking.to is not None:
            message = Seek(self._seeking.to, True)  # pause there
        self._session.on_control(message)
        match message:
            case Pause():
                self._frozen = self._arrival or (self._drawn[:2] if self._drawn else None)
            case Seek():
                self._seeking, self._frozen, self._arrival = message, None, None
                self._seeks += 1
            case Play():
                self._frozen = None
            case ViewMessage(camera):
                self._camera = camera
            case Shown(picture):
                self._shown = max(self._shown, min(picture, self._number))
            case Pick():
                self._picks = [*self._picks[-7:], message]
        self._changed.set()

    async def run(self) -> None:
        """Send pictures to the viewer until it leaves.

        Raises:
            SessionError: the connection is to be closed with its code.
        """
        if self._renderer.is_full:
            self._stream.counters.thin_refused += 1
            if self._renderer.seats == 0:
                raise SessionError(CloseCode.FORBIDDEN, "this server draws no pictures")
            fault = f"the server draws for {self._renderer.seats} viewers already; try again later"
            raise SessionError(CloseCode.BUSY, fault)
        tasks: list[asyncio.Task[None]] = []
        with self._renderer.seat():
            self._stream.thin_viewers += 1
            try:
                tasks = [asyncio.create_task(self._session.run()), asyncio.create_task(self._draw())]
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                self._stream.thin_viewers -= 1
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            task.result()

    def _arrived(self, mode: str) -> None:
        """The session is where the viewer asked to be."""
        seek, self._seeking = self._seeking, None
        if mode == "replay" and self._decoding.scene is not None and self._decoding.levels:
            self._arrival = self._decoding.scene, self._decoding.levels
            if seek is not None and seek.stop:
                self._session.pause()
        self._changed.set()

    @property
    def _state(self) -> tuple[Scene | None, int]:
        """The scene to draw, and how many levels of it."""
        return self._frozen or self._arrival or (self._decoding.scene, self._decoding.levels)

    async def _draw(self) -> None:
        """Draw picture after picture: at once when something changes, then a better one when nothing does."""
        shown = 0  # index of the newest picture's grade
        while True:
            self._changed.clear()
            scene, levels = self._state
            if scene is not None and levels:
                await self._introduce(scene)
                await self._answer(scene, levels)
            (scene, levels), camera = self._state, self._camera  # that took time
            if scene is None or not levels or camera is None or self._seeking is not None:
                await self._changed.wait()
                continue
            index = self._grades.moving
            if self._drawn == (scene, levels, camera):
                index = self._grades.resting(shown)
                if index == shown:
                    await self._changed.wait()
                    continue
                if not await self._rests():
                    continue
            self._drawn, self._arrival = (scene, levels, camera), None
            await self._picture(scene, camera, levels, index)
            shown = index

    async def _rests(self) -> bool:
        """Wait for a change; returns whether none came in time."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_REST_SECONDS):
                await self._changed.wait()
        return not self._changed.is_set()

    async def _picture(self, scene: Scene, camera: Camera, levels: int, index: int) -> None:
        """Draw, send, and wait until it is on the viewer's screen; what a seek has overtaken is not sent."""
        begin, grade, seeks = time.monotonic(), GRADES[index], self._seeks
        place = self._session.position
        rendered = await self._renderer.run(
            lambda: self._renderer.render_picture(self._splatter, scene, camera, levels, grade)
        )
        if seeks != self._seeks:
            return  # nobody waits for it any more
        self._number += 1
        head = (
            self._number,
            place.epoch if place else 0,
            scene.version,
            rendered.width,
            rendered.height,
            grade.quality,
            levels,
            0,
        )
        data = HEADER.pack(*head, int(rendered.seconds * 1e6)) + rendered.jpeg
        counters = self._stream.counters
        counters.pictures += 1
        counters.picture_bytes += len(data)
        counters.picture_seconds += rendered.seconds
        await self._viewer.binary(BinaryMessage(data))
        await self._acknowledged()
        seconds = time.monotonic() - begin
        self._grades.delivered(index, seconds)
        await asyncio.sleep(max(0.0, _MIN_INTERVAL_SECONDS - seconds))

    async def _acknowledged(self) -> None:
        limit = self._limits.stuck_seconds
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit):
                while self._shown < self._number:
                    self._changed.clear()
                    await self._changed.wait()
                return
        self._stream.counters.stuck += 1
        raise SessionError(CloseCode.BUSY, f"no picture was acknowledged for {limit:g} s")

    async def _introduce(self, scene: Scene) -> None:
        """Send a scene event for each new scene."""
        if self._keyframe is not None and self._keyframe.weights is scene.weights:
            return
        self._keyframe, header = scene, scene.header
        cameras = [
            {
                "name": camera.name, "width": camera.width, "height": camera.height,
                "intrinsics": camera.intrinsics.ravel().tolist(),
                "world_to_camera": camera.world_to_camera.ravel().tolist(),
            }
            for camera in header.cameras
        ]  # fmt: skip
        facts: dict[str, Any] = {"background": header.background.tolist(), "fps": header.fps}
        facts |= {"levels": header.octree.levels, "view_dependent": header.view_dependent, "cameras": cameras}
        await self._viewer.text(json.dumps(event("scene", **facts)))

    async def _answer(self, scene: Scene, levels: int) -> None:
        """Answer pick messages."""
        picks, self._picks = self._picks, []
        for pick in picks:
            point, depth = await self._renderer.run(partial(self._look, scene, levels, pick))
            await self._viewer.text(json.dumps(event("picked", id=pick.id, point=point, depth=depth)))

    def _look(self, scene: Scene, levels: int, pick: Pick) -> tuple[list[float] | None, float]:
        pose = np.concatenate([np.eye(3), -pick.origin[:, None]], axis=1)
        cloud = self._splatter.cloud(scene, pinhole("pick", (1, 1), (0, 0), (1, 1), pose), levels)
        return look_along(cloud, scene, pick.origin, pick.direction)
