"""Coding 0: columns of 32-bit integers under deflate, for clients without an entropy decoder. FORMAT.md section 6.1."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Int32
from streamlod.core.errors import BitstreamError

CODING = 0
_HEAD = struct.Struct("<BI")
_RAW_DEFLATE = -15
_PIECE = 1 << 12  # bytes inflated at a time, to at most 4 MB


def encode_plain(matrix: NDArray[Any]) -> bytes:
    """Matrix [n,C] of integers in int32 range as a chunk of coding 0."""
    columns = np.ascontiguousarray(matrix.T).astype("<i4")
    packer = zlib.compressobj(6, zlib.DEFLATED, _RAW_DEFLATE)
    return _HEAD.pack(CODING, len(matrix)) + packer.compress(columns.tobytes()) + packer.flush()


def row_count(data: bytes) -> int:
    """The number of rows that a chunk announces behind its coding.

    Raises:
        BitstreamError: `corrupt_chunk`, it is 0, or the chunk ends before it.
    """
    if len(data) < _HEAD.size:
        raise BitstreamError("corrupt_chunk", "a chunk ends before its row count")
    count: int = _HEAD.unpack_from(data)[1]
    if count == 0:
        raise BitstreamError("corrupt_chunk", "a chunk without rows must be left out")
    return count


def decode_plain(data: bytes, columns: int) -> Int32:
    """Matrix [n,`columns`], read-only, of a chunk of coding 0 whose row count has been found acceptable.

    Raises:
        BitstreamError: `corrupt_chunk`, the deflate data are not exactly these numbers.
    """
    count = row_count(data)
    wanted = 4 * columns * count
    content = bytearray(wanted)
    try:
        whole = _inflate(memoryview(data)[_HEAD.size :], memoryview(content))
    except zlib.error as error:
        raise BitstreamError("corrupt_chunk", f"deflate data are damaged: {error}") from error
    if not whole:
        raise BitstreamError("corrupt_chunk", f"deflate data do not hold exactly {wanted} bytes")
    return np.asarray(np.frombuffer(content, "<i4").reshape(columns, count).T, np.int32)


def _inflate(data: memoryview, out: memoryview) -> bool:
    """Inflate all of `data` into all of `out`, a piece at a time; False if they do not fit each other."""
    inflater, at = zlib.decompressobj(_RAW_DEFLATE), 0
    for start in range(0, len(data), _PIECE):
        content = inflater.decompress(data[start : start + _PIECE], len(out) - at + 1)  # one more, to see an excess
        if inflater.unused_data or at + len(content) > len(out):
            return False
        out[at : at + len(content)] = content
        at += len(content)
        if inflater.eof:
            return start + _PIECE >= len(data) and at == len(out)
    return False
