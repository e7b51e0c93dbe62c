"""Pictures of each stream and its cameras, and what other sites need to show its page inside theirs (oEmbed 1.0)."""

from __future__ import annotations

import asyncio
import hashlib
import html
from functools import partial
from typing import Annotated, Any
from urllib.parse import parse_qs, quote, urlencode, urlsplit
from weakref import WeakKeyDictionary

import numpy as np
from fastapi import APIRouter, Query, Request, Response

from streamlod.core.camera import Camera
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.server.api.access import StreamOf, need, refusal, registry_of
from streamlod.server.api.looks import PREVIEW_SIZE, Look, Looks, camera_of
from streamlod.server.api.ranges import FRESH, Download, respond
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import PROBLEMS, Problem
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.renderer import Grade, PictureRenderer, RenderedPicture, fitted

MAX_POSTER_PIXELS = 640 * 480
_GRADE = Grade(1, 80)
_MAX_NUMBER = 2**32 - 1
_WIDTH, _HEIGHT = 640, 360  # of the frame, where the asking site gives no bounds
_ANSWERS: dict[int | str, dict[str, Any]] = {status: PROBLEMS[status] for status in (401, 403, 404, 422, 429)}

router = APIRouter(tags=["posters"], responses=_ANSWERS)


class Posters:
    """The newest picture of each stream, drawn once a keyframe when somebody asks for it."""

    def __init__(self) -> None:
        self._made: WeakKeyDictionary[Stream, tuple[object, asyncio.Task[RenderedPicture]]] = WeakKeyDictionary()
        self._looks = Looks()

    async def of(self, stream: Stream, renderer: PictureRenderer, look: Look) -> bytes:
        """A JPEG file of `stream` as the camera in the middle of its rig sees it, or as `look` says.

        Raises:
            Problem: 404, there is nothing to draw; 503, not now.
        """
        scene = stream.hub.scene
        if scene is None or not scene.header.cameras:
            raise Problem(404, "the stream has no picture yet")
        if not look.is_plain:
            return await self._looks.draw(stream, look, renderer, fitted(middle_camera(scene), 1, MAX_POSTER_PIXELS))
        made = self._made.get(stream)
        if made is None or made[0] is not scene.weights:
            camera = fitted(middle_camera(scene), 1, MAX_POSTER_PIXELS)
            drawing = partial(renderer.render_picture, Splatter(), scene, camera, len(scene.levels), _GRADE)
            made = scene.weights, asyncio.create_task(renderer.run(drawing))
            self._made[stream] = made
        return (await asyncio.shield(made[1])).jpeg


def middle_camera(scene: Scene) -> Camera:
    """The camera of the rig nearest to the middle of all, from which a visit begins."""
    cameras = scene.header.cameras
    centres = np.stack([camera.centre for camera in cameras])
    return cameras[int(np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin())]


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
    etag = hashlib.sha256(jpeg).hexdigest()[:32]
    return respond(request, Download((jpeg,), etag, "image/jpeg", FRESH, f"{stream.id}.jpg"))


@router.get(
    "/v1/streams/{stream_id}/cameras/{camera}.jpg", summary="What a camera of a stream sees", response_class=Response,
    dependencies=[need(Right.READ)],
)  # fmt: skip
async def camera_picture(stream: StreamOf, camera: str, request: Request) -> Response:
    """A small JPEG file, about one a second, with the setting `camera_pictures` and while the stream is trained."""
    jpeg = stream.camera_pictures.get(camera)
    if jpeg is None:
        raise Problem(404, "there is no picture of this camera")
    etag = hashlib.sha256(jpeg).hexdigest()[:32]
    return respond(request, Download((jpeg,), etag, "image/jpeg", FRESH, f"{stream.id}.jpg"))


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
    page = html.escape(f"{request.base_url}?{urlencode({**query, 'embed': '1'})}")
    look, scene = Look.of(query), stream.hub.scene
    picture: dict[str, str | int] = {}
    if scene is not None and scene.header.cameras:
        middle = fitted(middle_camera(scene), 1, MAX_POSTER_PIXELS)
        seen = PREVIEW_SIZE if look.camera else (middle.width, middle.height)
        address = f"{request.base_url}v1/streams/{quote(stream.id, safe='')}/poster.jpg{look.query}"
        picture = {"thumbnail_url": address, "thumbnail_width": seen[0], "thumbnail_height": seen[1]}
    answer: dict[str, str | int] = {
        "version": "1.0", "type": "rich", "provider_name": "streamlod", "provider_url": str(request.base_url),
        "title": stream.id, "width": width, "height": height,
        "html": f'<iframe src="{page}" width="{width}" height="{height}" style="border: 0" title="Free-viewpoint video"'
        ' allow="fullscreen; xr-spatial-tracking" allowfullscreen></iframe>',
    }  # fmt: skip
    return answer | picture


async def _stream_of(url: str, request: Request) -> tuple[Stream, dict[str, str]]:
    """The stream that a page's address means, and the address's parameters."""
    registry = registry_of(request)
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise Problem(422, "url: not an address") from error
    if parts.netloc != request.url.netloc or parts.path not in ("", "/", "/index.html"):
        raise Problem(404, "that is no page of this server")
    query = {name: values[0] for name, values in parse_qs(parts.query).items() if name != "token"}
    stream_id = query.get("stream") or next(iter(sorted(registry.streams)), "")
    problem = await refusal(registry.gate, request, Right.READ, stream_id)
    if problem is not None:
        raise problem
    if stream_id not in registry.streams:
        raise Problem(404, f"there is no stream {stream_id!r:.80}")
    return registry.streams[stream_id], query
