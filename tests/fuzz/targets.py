"""What is fuzzed: each target takes any bytes and lets nothing out but the documented refusals, which it swallows."""

from __future__ import annotations

import gzip
import struct
import tempfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from streamlod.client.playback import Playback
from streamlod.codec.chunks import level as chunks
from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.imported import import_files
from streamlod.codec.packet.bytes import HEADER_BYTES
from streamlod.codec.packet.limits import DecoderLimits, Room
from streamlod.codec.packet.packet import ChunkKind
from streamlod.core.errors import BitstreamError, InputError, SessionError
from streamlod.core.scene.anchors import AnchorLevel, SceneHeader, empty_level
from streamlod.server.protocol.messages import parse_control, parse_hello
from tests.codec.scenes import make_header
from tests.vectors.make import FOLDER, read_stream

LIMITS = DecoderLimits(packet_bytes=1 << 16, anchors=4096)
_MESSAGE = struct.Struct("<BH")  # of a session: who says it, and how many bytes
TEXT_TO_VIEWER, PACKET_TO_VIEWER, TEXT_TO_SERVER = range(3)


def repair(data: bytes) -> bytes:
    """`data` with the packet checksums that its own directory asks for, so that mutants reach the decoder's inside."""
    if len(data) < HEADER_BYTES:
        return data
    (count,) = struct.unpack_from("<H", data, 30)
    at, parts = HEADER_BYTES + 8 * count, []
    if at > len(data):
        return data
    for number in range(count):
        (word,) = struct.unpack_from("<I", data, HEADER_BYTES + 8 * number)
        length = word & 0xFFFFFF
        parts.append(struct.pack("<II", word, zlib.crc32(data[at : at + length])))
        at += length
    directory = b"".join(parts)
    checksum = zlib.crc32(directory, zlib.crc32(data[: HEADER_BYTES - 4]))
    return data[: HEADER_BYTES - 4] + struct.pack("<I", checksum) + directory + data[HEADER_BYTES + len(directory) :]


def messages(data: bytes) -> list[tuple[int, bytes]]:
    """A session's messages as (who, content); what is cut at the end is shorter than it claims."""
    found, at = [], 0
    while at + _MESSAGE.size <= len(data):
        who, length = _MESSAGE.unpack_from(data, at)
        at += _MESSAGE.size
        found.append((who % 3, data[at : at + length]))
        at += length
    return found


def joined(session: list[tuple[int, bytes]]) -> bytes:
    """Inverse of `messages`."""
    return b"".join(_MESSAGE.pack(who, len(content)) + content for who, content in session)


def repair_session(data: bytes) -> bytes:
    """A session whose packets have the right checksums."""
    return joined([(who, repair(said) if who == PACKET_TO_VIEWER else said) for who, said in messages(data)])


def repair_file(data: bytes) -> bytes:
    """A file whose packets, and whose index if there is one, have the right checksums."""
    parts, at = [data[:8]], 8
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        if size > len(data) - at - 4:
            break
        parts.append(data[at : at + 4] + repair(data[at + 4 : at + 4 + size]))
        at += 4 + size
    rest = data[at:]
    if len(rest) >= 16:
        rest = rest[:-8] + struct.pack("<I", zlib.crc32(rest[:-16])) + rest[-4:]
    return b"".join([*parts, rest])


def addressed(number: int, data: bytes) -> bytes:
    """An input of a target that has several subjects: `data` for subject `number`."""
    return struct.pack("<H", number) + data


def _subject(data: bytes, count: int) -> tuple[int, bytes]:
    """Inverse of `addressed`, for any bytes."""
    (number,) = struct.unpack("<H", data[:2].ljust(2, b"\0"))
    return number % count, data[2:]


def repair_addressed(data: bytes) -> bytes:
    """An addressed packet with the right checksums and, three times in four, with lengths that fit."""
    return data[:2] + repair(fit(data[2:]) if len(data) % 4 else data[2:])


def fit(data: bytes) -> bytes:
    """`data` with the length of the last chunk that its own directory asks for, so that insertions reach the inside."""
    if len(data) < HEADER_BYTES + 8:
        return data
    (count,) = struct.unpack_from("<H", data, 30)
    count = min(count, (len(data) - HEADER_BYTES) // 8)
    words = [struct.unpack_from("<I", data, HEADER_BYTES + 8 * number)[0] for number in range(count)]
    rest = len(data) - HEADER_BYTES - 8 * count - sum(word & 0xFFFFFF for word in words[:-1])
    if not words or not 0 <= rest < 1 << 24:
        return data
    at = HEADER_BYTES + 8 * (count - 1)
    return data[:at] + struct.pack("<I", words[-1] & 0xFF000000 | rest) + data[at + 4 :]


@cache
def ready() -> tuple[tuple[SceneDecoder, bytes], ...]:
    """For each conformance stream a decoder that has read all but its last packet, and that packet."""
    found = []
    for path in sorted(FOLDER.glob("*.slps")):
        *before, last = read_stream(path)
        decoder = SceneDecoder()
        for earlier in before:
            decoder.push(earlier)
        if len(last) <= LIMITS.packet_bytes and sum(map(len, decoder.scene.levels if decoder.scene else ())) < 1000:
            found.append((replaced(decoder, SceneDecoder(LIMITS)), last))
    return tuple(found)


def replaced(ready: SceneDecoder, decoder: SceneDecoder) -> SceneDecoder:
    """`decoder` with the state of `ready`: scenes are values, so nothing is copied."""
    limits = decoder.__dict__["_limits"]
    decoder.__dict__.update(ready.__dict__, _limits=limits)
    return decoder


def packet(data: bytes) -> None:
    """A packet for a decoder in one of many states."""
    number, candidate = _subject(data, len(ready()))
    decoder = replaced(ready()[number][0], SceneDecoder(LIMITS))
    before = decoder.scene, decoder.versions
    try:
        decoder.push(candidate)
    except BitstreamError:
        assert (decoder.scene, decoder.versions) == before, "a refused packet changed the state"


@cache
def _level() -> tuple[SceneHeader, AnchorLevel]:
    """A header, and a level of 200 rows of which every second was touched."""
    rows = np.arange(200)
    voxel = np.stack([rows >> 5, rows >> 2 & 7, rows & 3], axis=1).astype(np.int32)
    empty, touched = empty_level(2, 1), np.tile(np.array([0, 1], np.int16), 100)[:, None].repeat(24, axis=1)
    columns = {n: np.zeros((200, *getattr(empty, n).shape[1:]), getattr(empty, n).dtype) for n in empty.__slots__}
    return make_header(2, 1, 2), AnchorLevel(**{**columns, "voxel": voxel, "latent": touched})


CHUNKS = (ChunkKind.GEOMETRY, ChunkKind.BASE, ChunkKind.CHANGE, ChunkKind.REMOVED, ChunkKind.ADDED)


def entropy(data: bytes) -> None:
    """A chunk's content, for one of the chunk decoders."""
    number, content = _subject(data, len(CHUNKS))
    header, level = _level()
    room = Room(4096, len(content))
    with suppress(BitstreamError):
        match CHUNKS[number]:
            case ChunkKind.GEOMETRY:
                chunks.decode_geometry(content, 1, room)
            case ChunkKind.BASE:
                chunks.decode_base(content, 1, header, level.voxel, room)
            case ChunkKind.CHANGE:
                chunks.decode_change(content, 1, level, Elapsed(9, 1), room)
            case ChunkKind.REMOVED:
                chunks.decode_removed(content, 1, level.alive, room)
            case ChunkKind.ADDED:
                chunks.decode_added(content, 1, header, room)


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="fuzz"))


@lru_cache(maxsize=64)
def _after(packets: tuple[bytes, ...]) -> SceneDecoder:
    """A decoder that was given these packets; remembered, because most mutants begin like their file."""
    if not packets:
        return SceneDecoder(LIMITS)
    decoder = replaced(_after(packets[:-1]), SceneDecoder(LIMITS))
    with suppress(BitstreamError):
        decoder.push(packets[-1])
    return decoder


def container(data: bytes) -> None:
    """A `.slod` file."""
    path = _folder() / "fuzz.slod"
    path.write_bytes(data)
    try:
        with SlodReader(path, LIMITS) as reader:
            packets = tuple(reader.packets())
            for count in range(len(packets) + 1):
                _after(packets[:count])
            with suppress(InputError):
                reader.plan(max((entry.to_version for entry in reader.entries), default=0))
    except BitstreamError:
        pass


FOREIGN = ("a.ply", "a.spz", "packed.spz")  # the last is packed here, so that mutants reach what is inside


def foreign(data: bytes) -> None:
    """A file of another program, for the importer."""
    number, content = _subject(data, len(FOREIGN))
    path = _folder() / FOREIGN[number]
    path.write_bytes(gzip.compress(content, 1) if path.stem == "packed" else content)
    with suppress(InputError):
        import_files(path, _folder() / "imported.slod")


def session(data: bytes) -> None:
    """What a viewer and a server say to each other, either side taking what the other might never have sent."""
    playback = Playback(LIMITS)
    for moment, (who, content) in enumerate(messages(data)[:64]):
        with suppress(SessionError):
            if who == PACKET_TO_VIEWER:
                before = playback.position
                try:
                    playback.receive_packet(content, 0.3 * moment)
                except SessionError:
                    assert playback.position == before, "a refused packet moved the viewer"
            elif who == TEXT_TO_VIEWER:
                playback.receive_text(content.decode(errors="replace"))
            else:
                parse = parse_control if moment else parse_hello
                parse(content.decode(errors="replace"))
        playback.acknowledgement(0.3 * moment)


TARGETS: dict[str, Callable[[bytes], None]] = {
    "packet": packet,
    "entropy": entropy,
    "container": container,
    "session": session,
    "foreign": foreign,
}
REPAIRS = {"packet": repair_addressed, "container": repair_file, "session": repair_session}
