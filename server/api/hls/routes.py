"""Streams over HTTP for other programs: HLS playlists and segments of MP4 (codec/FORMAT.md, section 19)."""

from __future__ import annotations

import asyncio
import time
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Annotated
from weakref import WeakKeyDictionary

from fastapi import APIRouter, Path, Request, Response

from streamlod.codec.container import Piece, SlodReader
from streamlod.codec.mp4.file import BEGINNING, INDEX, Group, groups_of, sound_of
from streamlod.codec.mp4.playlist import MEDIA_TYPE, SEGMENT_TYPE, Playlist, PlaylistPart, playlist_text, with_query
from streamlod.codec.mp4.segment import beginning
from streamlod.codec.sound.beside import find_sound
from streamlod.codec.sound.packets import OpusSettings
from streamlod.core.errors import StreamlodError
from streamlod.server.api.access import NEED_DOWNLOAD, StreamOf
from streamlod.server.api.downloads import (
    ANSWERS,
    Epoch,
    Incarnation,
    Version,
    check_incarnation,
    digest,
    retained,
    unreadable,
    without_previews,
)
from streamlod.server.api.hls.numbers import SegmentNumbers
from streamlod.server.api.hls.parts import end_of, finished_parts, seconds_of, segment_of
from streamlod.server.api.ranges import FRESH, IMMUTABLE, Download, respond
from streamlod.server.http.problems import Problem
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.bus import RetainedGroup
from streamlod.server.stream.stream import Stream

HLS = "/hls"
_BRIEF = "max-age=1"  # of a playlist that grows: a shared cache may answer all who ask within a second
router = APIRouter(prefix="/v1/streams/{stream_id}" + HLS, tags=["downloads"], dependencies=[NEED_DOWNLOAD])
_Number = Annotated[int, Path(ge=0, le=2**32 - 1, description="of the group of pictures in the file", examples=[0])]


@router.get("/" + INDEX, summary="HLS playlist", response_class=Response, responses=ANSWERS)
async def index(stream: StreamOf, request: Request) -> Response:
    """All that is retained, a segment for each group of pictures, and parts of about a second of the newest. Of a
    stream that plays a recording it is all of that, with its sound. A signature goes on to all that is named."""
    if stream.played_file is not None:
        groups, _ = await _played(stream.played_file)
        segments = (PlaylistPart(f"recording/{n}.m4s", group.seconds) for n, group in enumerate(groups))
        playlist = Playlist(BEGINNING, tuple(segments), is_complete=True)
    else:
        named: WeakKeyDictionary[Stream, SegmentNumbers] = request.app.state.segment_numbers
        playlist = await _retained(stream, named.setdefault(stream, SegmentNumbers()))
    query = request.url.query if "signature" in request.query_params else ""
    data = with_query(playlist_text(playlist), query).encode()
    caching = FRESH if stream.played_file is not None else _BRIEF
    return respond(request, Download((data,), digest(data), MEDIA_TYPE, caching, f"{stream.id}.m3u8"))


@router.get("/" + BEGINNING, summary="Initialisation segment", response_class=Response, responses=ANSWERS)
async def init(stream: StreamOf, request: Request) -> Response:
    """Which tracks there are; what each segment needs before it."""
    sound = None if stream.played_file is None else (await _played(stream.played_file))[1]
    data = beginning(sound)
    return respond(request, Download((data,), digest(data), SEGMENT_TYPE, FRESH, f"{stream.id}.mp4"))


@router.get(
    "/recording/{number}.m4s", summary="Segment of a played recording", response_class=Response, responses=ANSWERS
)
async def played_segment(stream: StreamOf, number: _Number, request: Request) -> Response:
    """A group of pictures of the file that the stream plays, with the sound that belongs to it."""
    if stream.played_file is None:
        raise Problem(404, "the stream plays no recording")
    groups, _ = await _played(stream.played_file)
    if number >= len(groups):
        raise Problem(404, f"the recording has {len(groups)} groups of pictures")
    changed_ns = (await asyncio.to_thread(stream.played_file.stat)).st_mtime_ns
    pieces, state = groups[number].pieces(stream.played_file), f"{stream.id} {changed_ns} {number}"
    return _segment(request, pieces, state, FRESH, f"{stream.id}-{number}.m4s")


@router.get(
    "/{incarnation}/{epoch}/{first}.m4s", summary="Segment of a stream", response_class=Response, responses=ANSWERS
)
async def segment(
    stream: StreamOf, incarnation: Incarnation, epoch: Epoch, first: Version, request: Request
) -> Response:
    """A group of pictures that is complete. Immutable."""
    check_incarnation(stream, incarnation)
    groups = await _groups(stream)
    place = Position(epoch, first)
    number = next((n for n, group in enumerate(groups) if group.first == place), None)
    if number is None:
        raise Problem(410 if stream.newest and place < stream.newest else 404, "that is not retained")
    if not _is_closed(stream, groups, number):
        raise Problem(404, "that group of pictures is not complete yet; the playlist names its parts")
    try:
        files = await stream.bus.files([place])
        pieces = await asyncio.to_thread(segment_of, files[place], end_of(groups, number))
    except OSError as error:
        raise unreadable(error) from error
    except (StreamlodError, KeyError, ValueError) as error:
        raise Problem(404, "that group of pictures cannot be read") from error
    state = f"{incarnation} {epoch} {first} {groups[number].last} {end_of(groups, number)}"
    return _segment(request, pieces, state, IMMUTABLE, f"{stream.id}-{epoch}-{first}.m4s")


@router.get(
    "/{incarnation}/{epoch}/parts/{first}-{last}.m4s", summary="Part", response_class=Response, responses=ANSWERS
)
async def part(
    stream: StreamOf, incarnation: Incarnation, epoch: Epoch, first: Version, last: Version, request: Request
) -> Response:
    """Packets that lead to these versions, as the playlist groups them. Immutable."""
    check_incarnation(stream, incarnation)
    try:
        packets = await stream.bus.read(Position(epoch, first), Position(epoch, last + 1))
    except OSError as error:
        raise unreadable(error) from error
    if len(packets) < 2 or packets[0].position.version != first or packets[-2].position.version != last:
        raise Problem(404, "that is not retained, or not complete yet")
    pieces = segment_of(packets[:-1], packets[-1].info.time_ns // 1000)
    state = f"{incarnation} {epoch} {first} {last}"
    return _segment(request, pieces, state, IMMUTABLE, f"{stream.id}-{epoch}-{first}-{last}.m4s")


async def _retained(stream: Stream, numbers: SegmentNumbers) -> Playlist:
    """The groups that are retained now, and the finished parts of the newest."""
    groups = await _groups(stream)
    if not groups:
        raise Problem(404, "the stream has no packet yet", {"Retry-After": "2"})
    closed = [number for number in range(len(groups)) if _is_closed(stream, groups, number)]
    longest = max((seconds_of(groups, number) for number in closed), default=1.0)
    begun_ms = (groups[0].begun_ns or time.time_ns()) // 10**6
    numbers.update([group.first for group in groups], begun_ms, longest)
    folder = stream.incarnation
    segments = tuple(
        PlaylistPart(
            f"{folder}/{group.first.epoch}/{group.first.version}.m4s",
            seconds_of(groups, number),
            is_run_start=number > 0 and groups[number - 1].first.epoch != group.first.epoch,
            begun_ns=group.begun_ns,
        )
        for number, group in enumerate(groups)
        if number in closed
    )
    parts: tuple[PlaylistPart, ...] = ()
    if len(closed) < len(groups):
        newest = groups[-1]
        packets = await stream.bus.read_group(newest.first, Position(newest.first.epoch, 2**32 - 1))
        is_run_start = len(groups) > 1 and groups[-2].first.epoch != newest.first.epoch
        parts = finished_parts(packets, f"{folder}/{newest.first.epoch}", is_run_start, newest.begun_ns)
    return Playlist(
        BEGINNING, segments, parts, numbers.first, numbers.runs_before, numbers.longest, stream.state == "ended"
    )


async def _groups(stream: Stream) -> list[RetainedGroup]:
    """Retained groups whose times are known."""
    return [group for group in without_previews(await retained(stream)) if group.first_time_ns is not None]


def _is_closed(stream: Stream, groups: list[RetainedGroup], number: int) -> bool:
    return number + 1 < len(groups) or stream.state == "ended"


async def _played(path: FilePath) -> tuple[tuple[Group, ...], OpusSettings | None]:
    """The groups of pictures of a played file, and the settings of its sound."""

    def read() -> tuple[tuple[Group, ...], OpusSettings | None]:
        sound = find_sound(path)
        return _read_played(path, path.stat().st_mtime_ns, None if sound is None else sound.changed_ns)

    try:
        return await asyncio.to_thread(read)
    except (OSError, StreamlodError) as error:
        raise Problem(404, "the recording cannot be read") from error


@lru_cache(maxsize=4)  # a player asks for one segment after the other, and all sound is read for each
def _read_played(
    path: FilePath, changed_ns: int, sound_changed_ns: int | None
) -> tuple[tuple[Group, ...], OpusSettings | None]:
    """The same as `_played` gives; kept for as long as neither file changes."""
    settings, packets = sound_of(path)
    with SlodReader(path) as reader:
        return groups_of(reader.entries, packets), settings


def _segment(request: Request, pieces: tuple[Piece, ...], state: str, caching: str, name: str) -> Response:
    """The answer with a segment, which stays the same for as long as `state` does."""
    return respond(request, Download(pieces, digest(state.encode()), SEGMENT_TYPE, caching, name))
