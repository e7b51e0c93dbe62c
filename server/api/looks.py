"""What a link of the viewer's page shows: a stream from somewhere, at some moment, as a picture."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass
from functools import partial
from urllib.parse import urlencode

import numpy as np

from streamlod.codec.decoder import SceneDecoder
from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, pinhole
from streamlod.core.errors import BitstreamError
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.server.http.problems import Problem
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.renderer import Grade, PictureRenderer

PREVIEW_SIZE = 640, 360  # pixels
_GRADE = Grade(1, 80)
_KEPT, _MAX_WAITING = 64, 8  # pictures
_POSE_NUMBERS, _MAX_COORDINATE, _MAX_FOCAL = 14, 1e9, 100.0


@dataclass(frozen=True, slots=True)
class Look:
    """A view and a moment as the page's address has them.

    Attributes:
        camera: a text of the page's `state.camera`; empty: the middle of the rig.
        version, epoch: of the state that is shown; None: the newest, of the newest run.
    """

    camera: str = ""
    version: int | None = None
    epoch: int | None = None

    @classmethod
    def of(cls, query: dict[str, str]) -> Look:
        """The look of an address with these parameters; what is no camera or number is left out."""
        camera, version, epoch = query.get("camera", ""), query.get("t", ""), query.get("epoch", "")
        numbers = (int(text) if text.isdecimal() and len(text) < 10 else None for text in (version, epoch))
        return cls(camera if camera_of(camera) else "", *numbers)

    @property
    def query(self) -> str:
        """As the parameters of an address, with a question mark where there are any."""
        said = {"camera": self.camera or None, "t": self.version, "epoch": self.epoch}
        told = {name: value for name, value in said.items() if value is not None}
        return f"?{urlencode(told)}" if told else ""

    @property
    def is_plain(self) -> bool:
        """Whether it is what everybody sees who opens the stream's page."""
        return not self.camera and self.version is None


def camera_of(text: str) -> Camera | None:
    """The camera of a text of the page's `state.camera`, of PREVIEW_SIZE; None where it is no such text."""
    try:
        numbers = np.array([float(part) for part in text.split(",", _POSE_NUMBERS)])
    except ValueError:
        return None
    if len(numbers) != _POSE_NUMBERS or not np.all(np.abs(numbers) < _MAX_COORDINATE):
        return None
    centre, ahead, below, (focal, *shift, stretch) = numbers[:3], numbers[3:6], numbers[6:9], numbers[10:]
    forward, right = _unit(ahead), _unit(np.cross(below, ahead))
    if forward is None or right is None or not (0 < focal < _MAX_FOCAL and 0 < stretch < _MAX_FOCAL):
        return None
    width, height = PREVIEW_SIZE
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.concatenate([rotation, (-rotation @ centre)[:, None]], axis=1)
    principal = width / 2 + shift[0] * height, height / 2 + shift[1] * height
    return pinhole("look", (focal * stretch * height, focal * height), principal, PREVIEW_SIZE, pose)


def _unit(vector: Float64) -> Float64 | None:
    length = float(np.linalg.norm(vector))
    return None if length < 1e-6 else np.asarray(vector / length, np.float64)


async def scene_at(stream: Stream, look: Look) -> Scene:
    """The state that `look` names.

    Raises:
        Problem: 404, the stream does not have it, or has nothing yet; 503, it cannot be read.
    """
    newest, scene = stream.newest, stream.hub.scene
    if newest is None or scene is None:
        raise Problem(404, "the stream has no picture yet")
    place = (
        newest if look.version is None else Position(newest.epoch if look.epoch is None else look.epoch, look.version)
    )
    if place == newest:
        return scene
    key = stream.bus.key_before(place)
    if key is None or key > place or key.epoch != place.epoch or place > newest:
        raise Problem(404, f"version {place.version} of epoch {place.epoch} cannot be shown")
    try:
        packets = await stream.bus.read(key, place)
        found = await asyncio.to_thread(_decoded, [packet.data for packet in packets])
    except (OSError, BitstreamError) as error:
        raise Problem(503, f"the past cannot be read now ({error})", {"Retry-After": "2"}) from error
    if found is None or found.version != place.version:
        raise Problem(404, f"version {place.version} of epoch {place.epoch} cannot be shown")
    return found


def _decoded(packets: list[bytes]) -> Scene | None:
    decoder = SceneDecoder()
    for packet in packets:
        decoder.push(packet)
    return decoder.scene


class Looks:
    """Pictures of looks, drawn when somebody asks; the newest are kept, and few may wait for one."""

    def __init__(self) -> None:
        self._made: OrderedDict[tuple[str, Look, int], bytes] = OrderedDict()
        self._waiting = 0

    async def draw(self, stream: Stream, look: Look, renderer: PictureRenderer, middle: Camera) -> bytes:
        """A JPEG file of PREVIEW_SIZE, or of the size of `middle` where the look names no camera.

        Raises:
            Problem: as `scene_at`; 503, too many wait already.
        """
        if self._waiting >= _MAX_WAITING:
            raise Problem(503, "too many pictures are being drawn", {"Retry-After": "2"})
        self._waiting += 1
        try:
            return await self._draw(stream, look, renderer, middle)
        finally:
            self._waiting -= 1

    async def _draw(self, stream: Stream, look: Look, renderer: PictureRenderer, middle: Camera) -> bytes:
        scene = await scene_at(stream, look)
        key = stream.incarnation, look, scene.version
        if (made := self._made.get(key)) is not None:
            return made
        camera = camera_of(look.camera) or middle
        drawing = partial(renderer.render_picture, Splatter(), scene, camera, len(scene.levels), _GRADE)
        jpeg = self._made[key] = (await renderer.run(drawing)).jpeg
        if len(self._made) > _KEPT:
            self._made.popitem(last=False)
        return jpeg
