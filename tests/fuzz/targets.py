"""What is fuzzed: each target takes any bytes and lets nothing out but the documented refusals, which it swallows."""

from __future__ import annotations

import struct
import tempfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from functools import cache
from pathlib import Path

import numpy as np

from client.playback import Playback
from codec.chunks import level as chunks
from codec.chunks.change import Elapsed
from codec.container import SlodReader
from codec.decoder import SceneDecoder
from codec.packet.bytes import HEADER_BYTES
from codec.packet.limits import DecoderLimits, Room
from core.errors import BitstreamError, InputError, SessionError
from core.scene.anchors import AnchorLevel, empty_level
from server.protocol.messages import parse_control, parse_hello
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


@cache
def _decoders() -> tuple[SceneDecoder, ...]:
    """Decoders without a state, and with states that the last packet of a stream fits."""
    decoders = [SceneDecoder(LIMITS)]
    for name in ("valid-growth-profile1", "valid-extremes-profile1", "valid-levels-apart"):
        decoder = SceneDecoder(LIMITS)
        for earlier in read_stream(FOLDER / f"{name}.slps")[:-1]:
            decoder.push(earlier)
        decoders.append(decoder)
    return tuple(decoders)


def packet(data: bytes) -> None:
    """One packet, as it is and repaired, for a decoder without and with a state."""
    for candidate in (data, repair(data)):
        for ready in _decoders():
            decoder = copy(ready)
            before = decoder.scene, decoder.versions
            try:
                decoder.push(candidate)
            except BitstreamError:
                assert (decoder.scene, decoder.versions) == before, "a refused packet changed the state"


def entropy(data: bytes) -> None:
    """A chunk's content, for each chunk decoder in turn."""
    header = make_header(2, 1, 2)
    rows = np.arange(200)
    voxel = np.stack([rows >> 5, rows >> 2 & 7, rows & 3], axis=1).astype(np.int32)
    empty, touched = empty_level(2, 1), np.tile(np.array([0, 1], np.int16), 100)[:, None].repeat(24, axis=1)
    columns = {n: np.zeros((200, *getattr(empty, n).shape[1:]), getattr(empty, n).dtype) for n in empty.__slots__}
    level = AnchorLevel(**{**columns, "voxel": voxel, "latent": touched})
    room = Room(4096, len(data))
    for decode in (
        lambda: chunks.decode_geometry(data, 1, room),
        lambda: chunks.decode_base(data, 1, header, voxel, room),
        lambda: chunks.decode_change(data, 1, level, Elapsed(9, 1), room),
        lambda: chunks.decode_removed(data, 1, level.alive, room),
        lambda: chunks.decode_added(data, 1, header, room),
    ):
        with suppress(BitstreamError):
            decode()


def container(data: bytes) -> None:
    """A `.slod` file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fuzz.slod"
        path.write_bytes(data)
        try:
            with SlodReader(path, LIMITS) as reader:
                for content in reader.packets():
                    with suppress(BitstreamError):
                        SceneDecoder(LIMITS).push(content)
                with suppress(InputError):
                    reader.plan(max((entry.to_version for entry in reader.entries), default=0))
        except BitstreamError:
            pass


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
}
REPAIRS = {"packet": repair, "container": repair_file, "session": repair_session}
