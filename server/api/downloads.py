"""Packets, groups of pictures and whole bitstreams."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response

from streamlod.codec.container import FilePart, joined, size_of
from streamlod.codec.sound.beside import MAX_TIME_NS, MEDIA_TYPE, find_sound
from streamlod.codec.sound.packets import sound_file
from streamlod.core.errors import InputError, StreamlodError
from streamlod.server.api.access import NEED_DOWNLOAD, StreamOf
from streamlod.server.api.ranges import FRESH, IMMUTABLE, Download, WallClock, respond
from streamlod.server.http.problems import Problem, problems
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.bus import GroupFile, RetainedGroup
from streamlod.server.stream.stream import Stream

_PACKET_TYPE, _FILE_TYPE = "application/vnd.streamlod.packet", "application/vnd.streamlod"
_MAX_NUMBER = 2**32 - 1
ANSWERS: dict[int | str, dict[str, Any]] = {
    206: {"description": "the range asked for"},
    304: {"description": "what the client has is current"},
    **problems(401, 403, 404, 409, 410, 416, 422, 429),
}

Epoch = Annotated[int, Path(ge=0, le=_MAX_NUMBER, description="encoder run", examples=[1])]
Version = Annotated[int, Path(ge=0, le=_MAX_NUMBER, description="number of the state in its epoch", examples=[0])]

router = APIRouter(prefix="/v1/streams/{stream_id}", tags=["downloads"], dependencies=[NEED_DOWNLOAD])
played = APIRouter(prefix="/v1/streams/{stream_id}", tags=["downloads"], dependencies=[NEED_DOWNLOAD])


RECORDING, SOUND = "/recording", "/sound"
_PACKET, _GROUP = "/packets/{epoch}/{version}", "/gops/{epoch}/{first}"
_FOR_GOOD = "/incarnations/{incarnation}"  # addresses below it never lead to anything else
Incarnation = Annotated[str, Path(pattern="^[0-9a-f]{16}$", description="of the stream", examples=["9f86d081884c7d65"])]


@router.get(_PACKET, summary="One packet of the present stream", response_class=Response, responses=ANSWERS)
async def packet(stream: StreamOf, epoch: Epoch, version: Version, request: Request) -> Response:
    """The packet that leads to this version, as in codec/FORMAT.md."""
    return respond(request, await _packet(stream, epoch, version, FRESH))


@router.get(_FOR_GOOD + _PACKET, summary="One packet", response_class=Response, responses=ANSWERS)
async def packet_for_good(
    stream: StreamOf, incarnation: Incarnation, epoch: Epoch, version: Version, request: Request
) -> Response:
    """The packet that leads to this version, as in codec/FORMAT.md. Immutable."""
    check_incarnation(stream, incarnation)
    return respond(request, await _packet(stream, epoch, version, IMMUTABLE))


@router.get(_GROUP, summary="One group of pictures of the present stream", response_class=Response, responses=ANSWERS)
async def group(stream: StreamOf, epoch: Epoch, first: Version, request: Request) -> Response:
    """A keyframe and its residuals as a `.slod` file."""
    return respond(request, await _group_file(stream, epoch, first, FRESH))


@router.get(_FOR_GOOD + _GROUP, summary="One group of pictures", response_class=Response, responses=ANSWERS)
async def group_for_good(
    stream: StreamOf, incarnation: Incarnation, epoch: Epoch, first: Version, request: Request
) -> Response:
    """A keyframe and its residuals as a `.slod` file. Immutable once a later keyframe has come."""
    check_incarnation(stream, incarnation)
    return respond(request, await _group_file(stream, epoch, first, IMMUTABLE))


@router.get("/bitstream", summary="Everything retained of one epoch", response_class=Response, responses=ANSWERS)
async def bitstream(
    stream: StreamOf,
    request: Request,
    clock: WallClock,
    epoch: Annotated[int | None, Query(ge=0, le=_MAX_NUMBER, description="encoder run; the newest by default")] = None,
) -> Response:
    """All retained groups of pictures of one encoder run as a `.slod` file; with `from` or `to`, those between two
    times, which only a recording knows. Where these span several runs, `epoch` has to name one (409)."""
    groups = await retained(stream)
    if not clock.is_open:
        firsts = [group.first for group in clock.choose(groups) if epoch in (None, group.first.epoch)]
        return respond(request, await recorded_file(stream.id, stream.incarnation, await _files(stream, firsts)))
    kept = without_previews(groups)
    wanted = epoch if epoch is not None else max((group.first.epoch for group in kept), default=0)
    chosen = await _files(stream, [group.first for group in kept if group.first.epoch == wanted])
    if not chosen:
        raise _absent(stream, Position(wanted, 0)) if stream.newest else Problem(404, "the stream has no packet yet")
    return respond(request, await _joined(stream.id, stream.incarnation, chosen, FRESH, str(wanted)))


@played.get(RECORDING, summary="The file that the stream plays", response_class=Response, responses=ANSWERS)
async def recording(stream: StreamOf, request: Request) -> Response:
    """The whole `.slod` file behind a stream whose source is a recording, whatever part of it has been played."""
    if stream.played_file is None:
        raise Problem(404, "the stream plays no recording; what is retained of it is at bitstream")
    try:
        pieces = await asyncio.to_thread(joined, [stream.played_file])
    except (OSError, StreamlodError) as error:
        raise Problem(404, "the recording cannot be read") from error
    changed_ns = (await asyncio.to_thread(stream.played_file.stat)).st_mtime_ns
    state = f"{stream.id} {changed_ns} {list(map(size_of, pieces))}"
    return respond(request, Download(pieces, digest(state.encode()), _FILE_TYPE, FRESH, f"{stream.id}.slod"))


@played.get(SOUND, summary="The sound of the stream", response_class=Response, responses=ANSWERS)
async def sound(
    stream: StreamOf,
    request: Request,
    from_ns: Annotated[int, Query(ge=0, le=MAX_TIME_NS, description="of live sound: its begin, as packets count")] = 0,
    to_ns: Annotated[
        int | None, Query(ge=0, le=MAX_TIME_NS, description="of live sound: its end, an hour later at most")
    ] = None,
) -> Response:
    """An Ogg Opus file: that of the recording which the stream plays, or retained live sound from `from_ns` on."""
    found = None if stream.played_file is None else await asyncio.to_thread(find_sound, stream.played_file)
    if found is None:
        packets = await stream.sound_track.packets(from_ns, to_ns)
        if packets is None:
            raise Problem(404, "the stream has no sound, or none of these times")
        data = await asyncio.to_thread(sound_file, *packets, stream.sound_track.camera)
        return respond(request, Download((data,), digest(data), MEDIA_TYPE, FRESH, f"{stream.id}.opus"))
    state = f"{stream.id} {found.changed_ns} {found.size_bytes} sound"
    whole = FilePart(found.path, 0, found.size_bytes)
    return respond(request, Download((whole,), digest(state.encode()), MEDIA_TYPE, FRESH, f"{stream.id}.opus"))


async def _packet(stream: Stream, epoch: int, version: int, caching: str) -> Download:
    place = Position(epoch, version)
    try:
        found = await stream.bus.read(place, place)
    except OSError as error:
        raise unreadable(error) from error
    if not found:
        raise _absent(stream, place)
    data = found[0].data
    return Download((data,), digest(data), _PACKET_TYPE, caching, f"{stream.id}-{epoch}-{version}.slpk")


async def _group_file(stream: Stream, epoch: int, first: int, caching: str) -> Download:
    place = Position(epoch, first)
    chosen = await _files(stream, [place])
    if not chosen:
        raise _absent(stream, place)
    closed = stream.bus.key_after(place) is not None
    caching = caching if closed else FRESH
    return await _joined(stream.id, stream.incarnation, chosen, caching, f"{epoch}-{first}")


async def retained(stream: Stream) -> list[RetainedGroup]:
    """All groups of pictures that are retained, up to the newest packet."""
    recording = stream.bus.recording
    if recording is not None:
        await recording.flush()
    try:
        return await stream.bus.groups()
    except OSError as error:
        raise unreadable(error) from error


def without_previews(groups: list[RetainedGroup]) -> list[RetainedGroup]:
    """Recorded groups, if there are any: early previews do not count beside them."""
    return [group for group in groups if group.begun_ns is not None] or groups


def check_incarnation(stream: Stream, incarnation: str) -> None:
    """Refuse an address that was made for an earlier stream of this id."""
    if incarnation != stream.incarnation:
        raise Problem(410, "that stream was deleted; there is another one of its id now")


async def _files(stream: Stream, firsts: list[Position]) -> dict[Position, GroupFile]:
    try:
        return await stream.bus.files(firsts)
    except InputError as error:
        raise Problem(422, str(error)) from error
    except OSError as error:
        raise unreadable(error) from error


def unreadable(error: Exception) -> Problem:
    """The answer where disk or network does not give what is retained."""
    return Problem(503, f"the past cannot be read now ({error})", {"Retry-After": "2"})


async def recorded_file(name: str, incarnation: str, groups: Mapping[Position, GroupFile]) -> Download:
    """Recorded groups of one encoder run as one file.

    Raises:
        Problem: 404 without any, 409 where they are of several runs.
    """
    epochs = sorted({place.epoch for place in groups})
    if not epochs:
        raise Problem(404, "nothing of that is recorded")
    if len(epochs) > 1:
        runs = f"{epochs[0]} to {epochs[-1]}"
        raise Problem(409, f"these are {len(epochs)} encoder runs, {runs}; name one with `epoch`")
    return await _joined(name, incarnation, groups, FRESH, str(epochs[0]))


async def _joined(
    name: str, incarnation: str, groups: Mapping[Position, GroupFile], caching: str, part: str
) -> Download:
    """Groups of pictures as one `.slod` file, whose name is that of their stream and of the `part` that they are."""
    parts = [
        [(packet.info, packet.data) for packet in group] if isinstance(group, list) else group
        for _, group in sorted(groups.items())
    ]
    try:
        pieces = await asyncio.to_thread(joined, parts)
    except OSError as error:
        raise unreadable(error) from error
    except StreamlodError as error:  # deleted meanwhile, or damaged
        raise Problem(404, "a group of pictures of it cannot be read") from error
    state = f"{incarnation} {sorted(groups)} {list(map(size_of, pieces))}"
    return Download(pieces, digest(state.encode()), _FILE_TYPE, caching, f"{name}-{part}.slod")


def digest(data: bytes) -> str:
    """A strong validator of what these bytes are, or say."""
    return hashlib.sha256(data).hexdigest()[:32]


def _absent(stream: Stream, place: Position) -> Problem:
    oldest = stream.bus.oldest
    if oldest is not None and Position(1, 0) <= place < oldest:
        return Problem(410, f"version {place.version} of epoch {place.epoch} has left the window")
    return Problem(404, f"there is no version {place.version} of epoch {place.epoch}")
