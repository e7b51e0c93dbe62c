"""What is fuzzed: each target takes any bytes and lets nothing out but `BitstreamError`, which it swallows."""

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

from codec import chunks
from codec.container import SlodReader
from codec.decoder import SceneDecoder
from codec.limits import Limits
from core.errors import BitstreamError, InputError
from tests.codec.scenes import make_header
from tests.vectors.make import FOLDER, read_stream

LIMITS = Limits(packet_bytes=1 << 16, anchors=4096)
_HEADER_BYTES = 36


def repair(data: bytes) -> bytes:
    """`data` with the packet checksums that its own directory asks for, so that mutants reach the decoder's inside."""
    if len(data) < _HEADER_BYTES:
        return data
    (count,) = struct.unpack_from("<H", data, 30)
    at, parts = _HEADER_BYTES + 8 * count, []
    if at > len(data):
        return data
    for number in range(count):
        (word,) = struct.unpack_from("<I", data, _HEADER_BYTES + 8 * number)
        length = word & 0xFFFFFF
        parts.append(struct.pack("<II", word, zlib.crc32(data[at : at + length])))
        at += length
    directory = b"".join(parts)
    checksum = zlib.crc32(directory, zlib.crc32(data[:32]))
    return data[:32] + struct.pack("<I", checksum) + directory + data[_HEADER_BYTES + len(directory) :]


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
    for decode in (
        lambda: chunks.decode_geometry(data, 1, 4096),
        lambda: chunks.decode_base(data, 1, header, voxel),
        lambda: chunks.decode_change(data, 1, voxel),
        lambda: chunks.decode_removed(data, 1, 200),
        lambda: chunks.decode_added(data, 1, header, 4096),
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
                    reader.plan(reader.version_at(1 << 40))
        except BitstreamError:
            pass


TARGETS: dict[str, Callable[[bytes], None]] = {"packet": packet, "entropy": entropy, "container": container}
