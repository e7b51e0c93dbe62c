"""The camera and moment that a program shows to those who follow it. docs/protocol.md, "Together"."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from streamlod.core.camera import Camera

_MIN_SECONDS = 0.1  # between two views; the newest counts
_AGAIN_SECONDS = 2.0  # after which the same is said once more, to a server that has forgotten or refused it
_NOTHING = json.dumps({"type": "present", "view": None})


class Presenter:
    """A program that presents: give it to `watch` as `WatchOptions.presents`, and call it while that runs.

    The server must offer it, and the token must have the right `present`; otherwise `watch` ends with a SessionError
    (4403). While somebody else presents nothing is shown, and the Notice `presenter` says who does.
    """

    def __init__(self) -> None:
        self._message = ""
        self._changed = asyncio.Event()

    def show(self, camera: Camera, distance: float, at: tuple[int, int] | None = None, plays: bool = False) -> None:
        """Show this view from now on.

        Args:
            camera: where it looks from; lens distortion is left out.
            distance: from there to what it looks at, around which followers turn once they drag, world units.
            at: (epoch, version) to look at; the live edge by default.
            plays: whether followers go on from there; otherwise they stand still.
        """
        pinhole = camera.undistorted()
        (fx, _, cx), (_, fy, cy), _ = pinhole.intrinsics.tolist()
        width, height = pinhole.width, pinhole.height
        view = {
            "position": pinhole.centre.tolist(),
            "rotation": pinhole.world_to_camera[:3, :3].ravel().tolist(),
            "distance": distance,
            "focal": fy / height,
            "stretch": fx / fy,
            "shift": [(cx - width / 2) / height, (cy - height / 2) / height],
        }
        moment: dict[str, object] = {"mode": "live"}
        if at is not None:
            moment = {"mode": "replay" if plays else "paused", "epoch": at[0], "version": at[1]}
        self._say(json.dumps({"type": "present", "view": view, "at": moment}))

    def stop(self) -> None:
        """Show nothing any more."""
        self._say(_NOTHING)

    def _say(self, message: str) -> None:
        self._message = message
        self._changed.set()

    async def run(self, socket: ClientConnection) -> None:
        """Say over a connection what is shown, until it closes."""
        with suppress(ConnectionClosed):
            while True:
                self._changed.clear()
                if message := self._message:
                    await socket.send(message)
                    await asyncio.sleep(_MIN_SECONDS)
                if message == _NOTHING == self._message:
                    self._message = ""  # said once
                with suppress(TimeoutError):
                    async with asyncio.timeout(_AGAIN_SECONDS):
                        await self._changed.wait()
