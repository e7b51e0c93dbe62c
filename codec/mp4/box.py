"""Boxes, of which MP4 files are made. ISO/IEC 14496-12:2022, section 4.2."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from streamlod.core.errors import BitstreamError

HEAD = struct.Struct(">I4s")
LARGE = struct.Struct(">Q")  # the size, behind the head, where that says 1
_FULL = struct.Struct(">I")  # version and flags


@dataclass(frozen=True, slots=True)
class Mp4Box:
    """A box of a file.

    Attributes:
        kind: four bytes.
        body: its content.
    """

    kind: bytes
    body: memoryview


def box(kind: bytes, *content: bytes) -> bytes:
    """A box around its content."""
    body = b"".join(content)
    return HEAD.pack(HEAD.size + len(body), kind) + body


def full_box(kind: bytes, version: int, flags: int, *content: bytes) -> bytes:
    """A box that begins with a version and flags."""
    return box(kind, _FULL.pack(version << 24 | flags), *content)


def boxes(data: memoryview) -> Iterator[Mp4Box]:
    """The boxes that lie one after the other in `data`.

    Raises:
        BitstreamError: `bad_file`, one that is too short or goes beyond the end.
    """
    at = 0
    while at < len(data):
        head, size, kind = HEAD.size, 0, b""
        if at + head <= len(data):
            size, kind = HEAD.unpack_from(data, at)
        if size == 1 and at + head + LARGE.size <= len(data):
            (size,) = LARGE.unpack_from(data, at + head)
            head += LARGE.size
        if not head <= size <= len(data) - at:
            raise refused(f"box {_readable(kind)} of {size} bytes does not fit into the {len(data) - at} that hold it")
        yield Mp4Box(kind, data[at + head : at + size])
        at += size


def child(data: memoryview, *path: bytes) -> memoryview:
    """The content of the first box along `path`, one inside the other.

    Raises:
        BitstreamError: `bad_file`, there is none.
    """
    for kind in path:
        found = next((each.body for each in boxes(data) if each.kind == kind), None)
        if found is None:
            raise refused(f"there is no box {_readable(kind)}")
        data = found
    return data


def version_and_flags(body: memoryview) -> tuple[int, int, memoryview]:
    """Version and flags at the beginning of a box, and what follows."""
    word, rest = take(_FULL, body)
    return word[0] >> 24, word[0] & 0xFFFFFF, rest


def take(layout: struct.Struct, data: memoryview) -> tuple[tuple[int, ...], memoryview]:
    """The fields at the beginning of `data`, and what follows.

    Raises:
        BitstreamError: `bad_file`, they are not all there.
    """
    if len(data) < layout.size:
        raise refused(f"a box ends {layout.size - len(data)} bytes too early")
    return layout.unpack_from(data), data[layout.size :]


def refused(fault: str) -> BitstreamError:
    """The error for a file whose boxes cannot be used."""
    return BitstreamError("bad_file", fault)


def _readable(kind: bytes) -> str:
    return kind.decode("ascii", "backslashreplace")
