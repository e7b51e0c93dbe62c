"""Recordings of all streams, those of deleted ones among them: list, download, delete."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import groupby
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from streamlod.server.api.access import grant_of, need, registry_of
from streamlod.server.api.downloads import recorded_file
from streamlod.server.api.ranges import WallClock, respond
from streamlod.server.api.registry import Registry
from streamlod.server.api.schemas import RecordingBody, RecordingList
from streamlod.server.auth.gate import Right
from streamlod.server.http.problems import Problem, problems
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.recording.segment import Segment

_ANSWERS = problems(401, 403, 404, 422, 429)
router = APIRouter(prefix="/v1/recordings", tags=["recordings"], responses=_ANSWERS)
Epoch = Annotated[int | None, Query(ge=0, le=2**32 - 1, description="encoder run; all by default")]


@router.get("", summary="What is recorded", dependencies=[need(Right.READ)])
async def list_recordings(
    request: Request,
    clock: WallClock,
    stream: Annotated[str | None, Query(max_length=64, description="of this stream only")] = None,
    cursor: Annotated[str | None, Query(max_length=80, description="from an earlier page")] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="recordings a page")] = 50,
) -> RecordingList:
    """One entry for every encoder run of every stream that the token may read, in order of stream and run."""
    registry, grant = registry_of(request), grant_of(request)
    found = [
        _describe(registry, name, epoch, segments)
        for name, recording in sorted(_recordings(registry).items())
        if grant.allows(Right.READ, name) and stream in (None, name)
        for epoch, segments in _runs(clock.choose(recording.segments))
    ]
    later = [each for each in found if cursor is None or _place(each) > cursor]
    page = later[:limit]
    return RecordingList(items=page, next_cursor=_place(page[-1]) if len(later) > limit else None)


def find_recording(
    request: Request, stream_id: Annotated[str, Path(max_length=64, description="of the stream, deleted or not")]
) -> Recording:
    """The recordings of a stream, whether it was deleted or not; 404 without."""
    recording = _recordings(registry_of(request)).get(stream_id)
    if recording is None:
        raise Problem(404, f"nothing of a stream {stream_id!r:.80} is recorded")
    return recording


RecordingOf = Annotated[Recording, Depends(find_recording)]


@router.get(
    "/{stream_id}/bitstream",
    summary="Download a recording",
    response_class=Response,
    responses=problems(409, 416),
    dependencies=[need(Right.READ)],
)
async def download_recording(
    recording: RecordingOf, request: Request, stream_id: str, clock: WallClock, epoch: Epoch = None
) -> Response:
    """The recording between two times, in whole groups of pictures, as a `.slod` file. A file holds one encoder
    run: where the times span several, `epoch` has to name one (409)."""
    await recording.flush()
    chosen = clock.choose(recording.segments)
    groups = {s.first: s.path for s in chosen if epoch in (None, s.first.epoch) and s.packets}
    return respond(request, await recorded_file(stream_id, recording.stored.incarnation, groups))


@router.delete("/{stream_id}", status_code=204, summary="Delete a recording", dependencies=[need(Right.CONTROL)])
async def delete_recording(
    recording: RecordingOf, request: Request, stream_id: str, clock: WallClock, epoch: Epoch = None
) -> None:
    """Delete what was recorded, or of it one encoder run or what lies between two times, in whole groups of pictures.
    The group that is being recorded stays."""
    registry = registry_of(request)
    if epoch is None and clock.is_open and await registry.erase_kept(stream_id):
        return
    chosen = {s.first for s in clock.choose(recording.segments) if epoch in (None, s.first.epoch)}
    if not chosen:
        raise Problem(404, "nothing of that is recorded")
    await recording.delete(chosen)


def _recordings(registry: Registry) -> dict[str, Recording]:
    """Recordings by stream."""
    running = {name: stream.bus.recording for name, stream in registry.streams.items() if stream.bus.recording}
    return {**registry.kept, **running}


def _runs(segments: list[Segment]) -> list[tuple[int, list[Segment]]]:
    return [(epoch, list(run)) for epoch, run in groupby(segments, lambda segment: segment.first.epoch)]


def _describe(registry: Registry, name: str, epoch: int, run: list[Segment]) -> RecordingBody:
    return RecordingBody(
        stream=name,
        deleted=name not in registry.streams,
        epoch=epoch,
        begun_at=datetime.fromtimestamp(run[0].begun_ns / 1e9, UTC),
        last_group_at=datetime.fromtimestamp(run[-1].begun_ns / 1e9, UTC),
        groups=len(run),
        packets=sum(segment.packets for segment in run),
        bytes=sum(segment.size_bytes for segment in run),
        path=f"/v1/recordings/{name}/bitstream?epoch={epoch}",
    )


def _place(recording: RecordingBody) -> str:
    return f"{recording.stream} {recording.epoch:010d}"
