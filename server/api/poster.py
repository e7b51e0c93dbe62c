"""Pictures of each stream and its cameras, and what other sites need to show its page inside theirs (oEmbed 1.0)."""

from __future__ import annotations

import asyncio
import html
from collections import OrderedDict
from dataclasses import dataclass
from functools import partial
from typing import Annotated
from urllib.parse import parse_qs, quote, urlencode, urlsplit
from weakref import WeakKeyDictionary

import numpy as np
from fastapi import APIRouter, Query, Request, Response

from streamlod.codec.decoder import SceneDecoder
from streamlod.core.camera import Camera
from streamlod.core.camera.view import camera_of_view, view_in
from streamlod.core.errors import BitstreamError
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.server.api.access import StreamOf, check_right, find_stream, need, registry_of
from streamlod.server.api.downloads import digest, unreadable
from streamlod.server.api.ranges import FRESH, Download, respond
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import Problem, problems
from streamlod.server.http.public_address import base_of
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.grades import Grade
from streamlod.server.viewer.renderer import PictureRenderer, RenderedPicture, fitted

MAX_POSTER_PIXELS = 640 * 480
_GRADE = Grade(1, 80)
_MAX_NUMBER = 2**32 - 1
_WIDTH, _HEIGHT = 640, 360  # of the frame, where the asking site gives no bounds
_ANSWERS = problems(401, 403, 404, 422, 429, 503)

PREVIEW_SIZE = 640, 360  # pixels
_KEPT, _MAX_WAITING = 64, 8  # pictures
_MAX_FOCAL = 100.0  # heights of the picture

router = APIRouter(tags=["posters"], responses=_ANSWERS)


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
        """The parameters of an address that asks for it, with a question mark where there are any."""
        said = {"camera": self.camera or None, "t": self.version, "epoch": self.epoch}
        told = {name: value for name, value in said.items() if value is not None}
        return f"?{urlencode(told)}" if told else ""

    @property
    def is_plain(self) -> bool:
        """Whether it is what everybody sees who opens the stream's page."""
        return not self.camera and self.version is None


def camera_of(text: str) -> Camera | None:
    """The camera of a text of the page's `state.camera`, of PREVIEW_SIZE; None where it is no such text."""
    numbers = view_in(text)
    if numbers is None or max(numbers[10], numbers[13]) >= _MAX_FOCAL:
        return None
    return camera_of_view("look", numbers, PREVIEW_SIZE)


async def scene_at(stream: Stream, look: Look) -> Scene:
    """The state that `look` names.

    Raises:
        Problem: 404, the stream does not have it, or has nothing yet; 503, it cannot be read.
    """
    newest, scene = stream.newest, stream.hub.scene
    if newest is None or scene is None:
        raise Problem(404, "the stream has no picture yet")
    if look.version is None:
        return scene
    place = Position(newest.epoch if look.epoch is None else look.epoch, look.version)
    if place == newest:
        return scene
    absent = Problem(404, f"version {place.version} of epoch {place.epoch} cannot be shown")
    key = stream.bus.key_before(place)
    if key is None or key > place or key.epoch != place.epoch or place > newest:
        raise absent
    try:
        packets = await stream.bus.read_group(key, place)
        found = await asyncio.to_thread(_decoded, [packet.data for packet in packets])
    except (OSError, BitstreamError) as error:
        raise unreadable(error) from error
    if found is None or found.version != place.version:
        raise absent
    return found


def _decoded(packets: list[bytes]) -> Scene | None:
    decoder = SceneDecoder()
    for packet in packets:
        decoder.push(packet)
    return decoder.scene


class Posters:
    """Pictures of streams, drawn when somebody asks.

    The newest of each stream is drawn once a keyframe. Of those with a view or moment the last ones are kept, and few
    requests may wait for one.
    """

    def __init__(self) -> None:
        self._newest: WeakKeyDictionary[Stream, tuple[object, asyncio.Task[RenderedPicture]]] = WeakKeyDictionary()
        self._looks: OrderedDict[tuple[str, Look, int], bytes] = OrderedDict()
        self._waiting = 0

    async def of(self, stream: Stream, renderer: PictureRenderer, look: Look) -> bytes:
        """A JPEG file of `stream` as the camera in the middle of its rig sees it, or as `look` says, then of
        PREVIEW_SIZE.

        Raises:
            Problem: 404, there is nothing to draw; 503, not now, or too many wait already.
        """
        scene = stream.hub.scene
        if scene is None or not scene.header.cameras:
            raise Problem(404, "the stream has no picture yet")
        if look.is_plain:
            made = self._newest.get(stream)
            if made is None or made[0] is not scene.weights:
                made = scene.weights, asyncio.create_task(_picture(renderer, scene, middle_camera(scene)))
                self._newest[stream] = made
            return (await asyncio.shield(made[1])).jpeg
        if self._waiting >= _MAX_WAITING:
            raise Problem(503, "too many pictures are being drawn", {"Retry-After": "2"})
        self._waiting += 1
        try:
            return await self._draw(stream, look, renderer, camera_of(look.camera) or middle_camera(scene))
        finally:
            self._waiting -= 1

    async def _draw(self, stream: Stream, look: Look, renderer: PictureRenderer, camera: Camera) -> bytes:
        scene = await scene_at(stream, look)
        key = stream.incarnation, look, scene.version
        if (made := self._looks.get(key)) is not None:
            return made
        jpeg = self._looks[key] = (await _picture(renderer, scene, camera)).jpeg
        if len(self._looks) > _KEPT:
            self._looks.popitem(last=False)
        return jpeg


async def _picture(renderer: PictureRenderer, scene: Scene, camera: Camera) -> RenderedPicture:
    return await renderer.run(partial(renderer.render_picture, Splatter(), scene, camera, len(scene.levels), _GRADE))


def middle_camera(scene: Scene) -> Camera:
    """The camera of the rig nearest to the middle of all, from which a visit begins, with as many pixels as a poster
    may have."""
    cameras = scene.header.cameras
    centres = np.stack([camera.centre for camera in cameras])
    nearest = cameras[int(np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin())]
    return fitted(nearest, 1, MAX_POSTER_PIXELS)


@router.get(
    "/v1/streams/{stream_id}/poster.jpg", summary="A picture of a stream", response_class=Response,
    dependencies=[need(Right.READ)],
)  # fmt: skip
async def poster(
    stream: StreamOf,
    request: Request,
    camera: Annotated[
        str, Query(max_length=400, description="from where: a text of the page's `state.camera`; the middle of the rig")
    ] = "",
    t: Annotated[int | None, Query(ge=0, le=_MAX_NUMBER, description="version that is shown; the newest")] = None,
    epoch: Annotated[int | None, Query(ge=0, le=_MAX_NUMBER, description="its encoder run; the newest")] = None,
) -> Response:
    """A JPEG file, made anew with each keyframe; of a view and moment as a link of the page names them."""
    if camera and camera_of(camera) is None:
        raise Problem(422, "camera: not a view as the page's links have it")
    jpeg = await request.app.state.posters.of(stream, registry_of(request).renderer, Look(camera, t, epoch))
    return respond(request, Download((jpeg,), digest(jpeg), "image/jpeg", FRESH, f"{stream.id}.jpg"))


@router.get(
    "/v1/streams/{stream_id}/cameras/{camera}.jpg", summary="What a camera of a stream sees", response_class=Response,
    dependencies=[need(Right.READ)],
)  # fmt: skip
async def camera_picture(stream: StreamOf, camera: str, request: Request) -> Response:
    """A small JPEG file, about one a second, with the setting `camera_pictures` and while the stream is trained.

    While `streamlod rig` films, there are two a second.
    """
    jpeg = stream.camera_pictures.get(camera)
    if jpeg is None:
        raise Problem(404, "there is no picture of this camera")
    return respond(request, Download((jpeg,), digest(jpeg), "image/jpeg", FRESH, f"{stream.id}.jpg"))


@router.get("/oembed", summary="How to show a page of this server in another")
async def oembed(
    request: Request,
    url: Annotated[
        str, Query(max_length=2000, description="of the viewer's page", examples=["http://HOST/?stream=main"])
    ],
    maxwidth: Annotated[int, Query(ge=1, le=8192, description="pixels")] = _WIDTH,
    maxheight: Annotated[int, Query(ge=1, le=8192, description="pixels")] = 8192,
) -> dict[str, str | int]:
    """An oEmbed 1.0 answer of type `rich`: a frame with the page, and the stream's picture."""
    stream, query = await _stream_of(url, request)
    width = min(maxwidth, maxheight * _WIDTH // _HEIGHT) or 1
    height = max(1, width * _HEIGHT // _WIDTH)
    base = base_of(request)
    page = html.escape(f"{base}?{urlencode({**query, 'embed': '1'})}")
    look, scene = Look.of(query), stream.hub.scene
    picture: dict[str, str | int] = {}
    if scene is not None and scene.header.cameras:
        middle = middle_camera(scene)
        seen = PREVIEW_SIZE if look.camera else (middle.width, middle.height)
        address = f"{base}v1/streams/{quote(stream.id, safe='')}/poster.jpg{look.query}"
        picture = {"thumbnail_url": address, "thumbnail_width": seen[0], "thumbnail_height": seen[1]}
    answer: dict[str, str | int] = {
        "version": "1.0", "type": "rich", "provider_name": "streamlod", "provider_url": base,
        "title": stream.id, "width": width, "height": height,
        "html": f'<iframe src="{page}" width="{width}" height="{height}" style="border: 0" title="Free-viewpoint video"'
        ' allow="fullscreen; xr-spatial-tracking" allowfullscreen></iframe>',
    }  # fmt: skip
    return answer | picture


async def _stream_of(url: str, request: Request) -> tuple[Stream, dict[str, str]]:
    """The stream that a page's address means, and the address's parameters."""
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise Problem(422, "url: not an address") from error
    root = urlsplit(base_of(request)).path
    if parts.netloc != request.url.netloc or parts.path not in (root.removesuffix("/"), root, f"{root}index.html"):
        raise Problem(404, "that is no page of this server")
    query = {name: values[0] for name, values in parse_qs(parts.query).items() if name != "token"}
    stream_id = query.get("stream") or min(registry_of(request).streams, default="")
    await check_right(request, Right.READ, stream_id)
    return find_stream(stream_id, request), query
