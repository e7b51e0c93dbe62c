"""Streams as REST resources: list, read, create, start, stop, delete, and the manifest."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from streamlod.core.errors import BitstreamError, InputError, StorageError, StreamGoneError
from streamlod.core.masking import masked
from streamlod.server.api.access import StreamOf, WorkerStreamOf, check_right, grant_of, need, registry_of
from streamlod.server.api.conditions import IfMatch, IfMatchHeader, check_match, tag_headers
from streamlod.server.api.downloads import unreadable
from streamlod.server.api.push import capture_address, scope_of
from streamlod.server.api.reach import check_reach
from streamlod.server.api.registry import Registry
from streamlod.server.api.schemas import Health, Link, Manifest, NewLink, StreamBody, StreamList
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import Problem, problems
from streamlod.server.pipeline.checks import check_job
from streamlod.server.pipeline.job import POINT_METHODS
from streamlod.server.pipeline.new_stream import NewStream, StreamChange
from streamlod.server.pipeline.recorded import streamed_packets
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.bus import RetainedGroup
from streamlod.server.stream.description import describe
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.worker_stream import WorkerStream

_USUAL = problems(400, 401, 403, 404, 413, 415, 422, 429)


@contextmanager
def _refusals() -> Iterator[None]:
    """Answer with a problem where the registry refuses to do something to a stream that was there."""
    try:
        yield
    except StorageError as error:
        raise Problem(507, str(error)) from error
    except StreamGoneError as error:
        raise Problem(404, str(error)) from error
    except InputError as error:
        raise Problem(409, str(error)) from error


router = APIRouter(prefix="/v1/streams", tags=["streams"], responses=_USUAL)
control = APIRouter(prefix="/v1/streams", tags=["streams"], responses=_USUAL)  # of streams that are made here


@router.get("", summary="All streams", dependencies=[need(Right.READ)])
async def list_streams(
    request: Request,
    cursor: Annotated[str | None, Query(max_length=64, description="from an earlier page")] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="streams a page")] = 50,
) -> StreamList:
    """The streams that the token may read, in order of their id."""
    streams, grant = registry_of(request).streams, grant_of(request)
    names = [name for name in sorted(streams) if grant.allows(Right.READ, name) and (cursor is None or name > cursor)]
    page = names[:limit]
    items = [_body(streams[name]) for name in page]
    return StreamList(items=items, next_cursor=page[-1] if len(names) > limit else None)


@control.post("", status_code=201, summary="Create a stream", responses=problems(409, 507))
async def create_stream(body: NewStream, request: Request, response: Response) -> StreamBody:
    """Create a stream from a data set, live cameras, a recorded file or a synthetic clip; idle without `start`. With
    it, a stream for which the workers' cluster has no room is not created: 409, with what would have to stop."""
    registry = registry_of(request)
    await check_right(request, Right.CONTROL, body.id)
    spec = await _checked(lambda: body.spec, request)
    try:
        stream = await registry.create(spec, start=body.start is True)
    except StorageError as error:
        raise Problem(507, str(error)) from error
    except InputError as error:
        raise Problem(409 if body.id in registry.streams else 422, str(error)) from error
    if no_room := await _until_placed(request, stream):
        if not stream.deleted:
            await _withdraw(registry, stream)
        raise Problem(409, no_room)
    response.headers.update({"Location": f"/v1/streams/{body.id}", **tag_headers(stream)})
    return _body(stream)


@router.get("/{stream_id}", summary="A stream's state", dependencies=[need(Right.READ)])
async def get_stream(stream: StreamOf, response: Response) -> StreamBody:
    """State, newest position, progress and figures of one stream. The ETag is that of its definition."""
    response.headers.update({**tag_headers(stream), "Cache-Control": "no-store"})
    return _body(stream)


@router.get(
    "/{stream_id}/ready",
    summary="Whether a stream delivers",
    dependencies=[need(Right.READ)],
    responses={503: {"model": Health, "description": "it does not"}},
)
async def get_ready(stream: StreamOf, response: Response) -> Health:
    """200 while the stream is live or has ended as it should; otherwise 503, with its state and the reason."""
    ready = stream.is_ready
    response.status_code = 200 if ready else 503
    return Health(status="ok" if ready else stream.state, detail=stream.detail)


@control.get("/{stream_id}/definition", summary="What a stream is made from", dependencies=[need(Right.CONTROL)])
async def get_definition(stream: WorkerStreamOf, response: Response) -> dict[str, Any]:
    """The fields with which the stream was created, and defaults; passwords are left out."""
    response.headers.update(tag_headers(stream))
    found: dict[str, Any] = masked(stream.spec.to_json())
    return found


@control.patch(
    "/{stream_id}",
    summary="Change a stream",
    dependencies=[need(Right.CONTROL)],
    responses=problems(409, 412, 507),
)
async def change_stream(
    body: StreamChange,
    stream: WorkerStreamOf,
    request: Request,
    response: Response,
    if_match: IfMatchHeader = None,
) -> StreamBody:
    """Change what a stream is made from: the fields that are given, `null` for a default, take effect at its next
    start. One that waits for its first viewer, and is not to wait (`on_demand`), starts at once. A stream that runs, or
    that the settings file defines, is not changed (409)."""
    registry = registry_of(request)
    check_match(stream, if_match)
    spec = await _checked(lambda: body.apply_to(stream.spec), request)
    with _refusals():
        await registry.change(stream, spec)
    response.headers.update(tag_headers(stream))
    return _body(stream)


@control.delete(
    "/{stream_id}",
    status_code=204,
    summary="Delete a stream",
    dependencies=[need(Right.CONTROL), IfMatch],
    responses=problems(412, 507),
)
async def delete_stream(
    stream: WorkerStreamOf,
    request: Request,
    erase: Annotated[bool, Query(description="erase what was recorded, too")] = False,
) -> None:
    """Stop a stream and close its viewers with 1000. What was recorded stays on the disk unless `erase` is given."""
    with _refusals():
        await registry_of(request).delete(stream, erase=erase)


async def _withdraw(registry: Registry, stream: WorkerStream) -> None:
    """Remove a stream that never ran; what an earlier one of its id recorded stays."""
    recording = stream.bus.recording
    with _refusals(), suppress(StreamGoneError):
        await registry.delete(stream, erase=recording is None or not recording.segments)


async def _until_placed(request: Request, stream: WorkerStream) -> str:
    """Why there is no room for a stream, naming others that the caller may see; nothing where there is."""
    grant = grant_of(request)
    return await stream.until_placed(lambda name: grant.allows(Right.READ, name))


@control.post(
    "/{stream_id}/start",
    status_code=202,
    summary="Start",
    dependencies=[need(Right.CONTROL), IfMatch],
    responses=problems(409, 412),
)
async def start_stream(stream: WorkerStreamOf, request: Request) -> StreamBody:
    """Start the worker; one that runs goes on, an ended source begins again. Where the workers' cluster has no room for
    it the answer is 409, with what would have to stop."""
    with _refusals():
        await registry_of(request).start_stream(stream)
    if no_room := await _until_placed(request, stream):
        raise Problem(409, no_room)
    return _body(stream)


@control.post(
    "/{stream_id}/stop",
    status_code=202,
    summary="Stop",
    dependencies=[need(Right.CONTROL), IfMatch],
    responses=problems(412),
)
async def stop_stream(stream: WorkerStreamOf, request: Request) -> StreamBody:
    """Stop the worker; viewers stay connected and the recording stays."""
    with _refusals():
        await registry_of(request).stop_stream(stream)
    return _body(stream)


@router.post(
    "/{stream_id}/links",
    status_code=201,
    summary="Sign an address of a download, or of a camera's page",
    dependencies=[need(Right.READ)],
    responses=problems(409),
)
async def create_link(body: NewLink, stream: StreamOf, request: Request) -> Link:
    """An address with which anybody may fetch a download, or all of the stream's, until it or the token expires. For
    `ingest/CAMERA` it is the page with which a phone films as that camera, and opens nothing else."""
    camera = body.path.removeprefix("ingest/") if body.path.startswith("ingest/") else None
    if camera is not None and not grant_of(request).allows(Right.PUBLISH, stream.id):
        raise Problem(403, "the token does not give the right to publish here")
    if camera is not None and stream.push_socket is None:
        raise Problem(409, "this stream takes no pictures: it is not made from live cameras")
    path = f"/v1/streams/{stream.id}/{body.path}"
    scope = path.removesuffix("index.m3u8") if camera is None else scope_of(stream.id, camera)
    expires = int(time.time()) + body.seconds
    if (limit := grant_of(request).expires) is not None:
        expires = min(expires, limit)
    query = registry_of(request).gate.links.sign(scope, expires, stream.incarnation)
    url = f"{path}{'' if body.path else 'bitstream'}?{query}"
    if camera is not None:
        url = capture_address(stream.id, camera, query)
    return Link(url=url, query=query, expires_at=datetime.fromtimestamp(expires, UTC))


@router.get("/{stream_id}/manifest", summary="Window and groups of pictures", dependencies=[need(Right.READ)])
async def get_manifest(
    stream: StreamOf,
    request: Request,
    after_epoch: Annotated[int | None, Query(ge=0, le=2**32 - 1, description="wait for something later")] = None,
    after_version: Annotated[int, Query(ge=0, le=2**32 - 1, description="than this position")] = 0,
    wait_ms: Annotated[int, Query(ge=0, le=10_000, description="wait at most so long")] = 0,
) -> Manifest:
    """Which versions can be seen and downloaded. With `after_epoch`, waits until the live edge is later than that."""
    registry = registry_of(request)
    if after_epoch is not None and wait_ms:
        await _wait_for_later(registry, stream, Position(after_epoch, after_version), wait_ms / 1000)
    try:
        groups = await stream.bus.groups()
    except OSError as error:
        raise unreadable(error) from error
    scene, newest = stream.hub.scene, stream.newest
    return Manifest.model_validate(
        {
            "stream": stream.id,
            "incarnation": stream.incarnation,
            "state": stream.state,
            "epoch": newest.epoch if newest else None,
            "window": stream.window,
            "levels": stream.levels,
            "fps": scene.header.fps if scene else None,
            "gops": [_group(stream, group) for group in groups],
            "edges": registry.edges,
        }
    )


def _body(stream: Stream) -> StreamBody:
    return StreamBody.model_validate(describe(stream))


async def _checked(make: Callable[[], StreamSpec], request: Request) -> StreamSpec:
    """The specification of a stream to be made; 422 where that cannot be used, or must not be reached."""
    try:
        spec = make()
        check_reach(spec, registry_of(request).settings, grant_of(request))
        await asyncio.to_thread(_check_source, spec)
    except (InputError, BitstreamError) as error:
        raise Problem(422, masked(str(error))) from error
    return spec


def _check_source(spec: StreamSpec) -> None:
    """Refuse what cannot be used, as far as no camera or recording need be opened to know; InputError if so."""
    if spec.play is not None:
        streamed_packets(spec.play)
        return
    job = spec.job
    assert job is not None
    if isinstance(job.live, dict):
        from streamlod.server.ingest.cameras.definition import read_definition

        read_definition(job.live)
    for name, path in (("data", job.data), ("live", job.live)):
        if isinstance(path, Path) and not path.exists():
            raise InputError(name, f"there is no {str(path)!r:.200} on the server")
    if job.points not in POINT_METHODS and not (points := Path(job.points)).is_file():
        fault = f"there is no file {str(points)!r:.200} on the server, and no method of this name"
        raise InputError("points", f"{fault}: {', '.join(POINT_METHODS)}")
    check_job(job)


async def _wait_for_later(registry: Registry, stream: Stream, place: Position, seconds: float) -> None:
    wake = asyncio.Event()
    stream.hub.listeners.add(wake.set)
    try:
        async with asyncio.timeout(seconds):
            while (stream.newest is None or stream.newest <= place) and not (stream.is_over or registry.draining):
                wake.clear()
                await wake.wait()
    except TimeoutError:
        return
    finally:
        stream.hub.listeners.discard(wake.set)


def _group(stream: Stream, group: RetainedGroup) -> dict[str, Any]:
    first = group.first
    return {
        "epoch": first.epoch,
        "first": first.version,
        "last": group.last.version,
        "packets": group.packets,
        "bytes": group.size_bytes,
        "begun_ns": group.begun_ns,
        "first_time_ns": group.first_time_ns,
        "last_time_ns": group.last_time_ns,
        "path": f"/v1/streams/{stream.id}/incarnations/{stream.incarnation}/gops/{first.epoch}/{first.version}",
    }
