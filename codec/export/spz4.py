"""The container of SPZ, version 4: a plain header, a table of sizes, and a Zstandard stream for each kind of number.

The numbers are those of version 3 (`spz.py`). Written from the format's public description
(github.com/nianticlabs/spz); needs the package `zstandard`, of the optional part `interchange`. Files are hostile.
"""

from __future__ import annotations

import importlib
import struct
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from streamlod.core.errors import InputError

_HEAD = struct.Struct("<16xI12x")  # behind what version 3 has as well: where the table begins, reserved
_LEVEL = 9  # of Zstandard
_MAX_WINDOW = 1 << 27  # bytes that a stream may look back


def pack(head: bytes, streams: Sequence[bytes]) -> bytes:
    """A file's bytes; `head` is that of version 3 up to its flags, 15 bytes."""
    compressor = _library().ZstdCompressor(level=_LEVEL)
    packed = [compressor.compress(stream) for stream in streams]
    table = [struct.pack("<QQ", len(short), len(plain)) for short, plain in zip(packed, streams, strict=True)]
    return b"".join((head, struct.pack("<BI12x", len(streams), _HEAD.size), *table, *packed))


def unpack(path: Path, data: bytes, sizes: Sequence[int]) -> bytes:
    """The first streams, of these sizes, one behind the other; extensions and further streams are passed over.

    Raises:
        InputError: the file is damaged, or has other sizes.
    """
    library = _library()
    if len(data) < _HEAD.size:
        raise InputError(path, "is cut off")
    streams, (table,) = data[15], _HEAD.unpack_from(data)
    end = table + 16 * streams
    if streams < len(sizes) or table < _HEAD.size or end > len(data):
        raise InputError(path, "is cut off, or its table of streams is damaged")
    announced = struct.unpack_from(f"<{2 * streams}Q", data, table)
    parts = []
    for size, packed, plain in zip(sizes, announced[::2], announced[1::2], strict=False):
        try:
            with library.ZstdDecompressor(max_window_size=_MAX_WINDOW).stream_reader(
                data[end : end + packed]
            ) as reader:
                parts.append(reader.read(size) if plain == size else b"")
        except library.ZstdError as error:
            raise InputError(path, f"is damaged: {error}") from error
        if len(parts[-1]) != size:
            raise InputError(path, f"is cut off or damaged: a stream should have {size} bytes, and has other")
        end += packed
    return b"".join(parts)


def _library() -> ModuleType:
    try:
        return importlib.import_module("zstandard")
    except ImportError as error:
        raise InputError("SPZ 4", "needs the package zstandard: pip install 'streamlod[interchange]'") from error
