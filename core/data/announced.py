"""Checks of encoded pictures before a decoder sees them: the size in the header, and the picture's own data alone.

A decoder that reads a header differently from us could be made to allocate more than was announced. So these readers
accept only what every decoder reads alike, one frame header among segments of known length (ITU-T T.81 section B.2,
PNG third edition, chunks), and refuse the rest. Compressed text and animations of PNG, which could unpack to any
size, are left out of what is decoded.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

MAX_SEGMENTS = 1024  # before the pixels of a JPEG
MAX_CHUNKS = 65536  # of a PNG
MAX_SCANS = 64  # of a JPEG; usual progressive ones have 10, and each costs a decoder the time of a whole picture

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_PIXELS = {b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"}
_WITH_ALPHA = {4, 6}  # colour types
_JPEG = b"\xff\xd8"
_EXIF_SEGMENT, _ORIENTATION = 0xE1, 0x0112
_END_OF_IMAGE, _START_OF_SCAN = 0xD9, 0xDA
_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)  # among entropy-coded data
_FRAME_HEADERS = {0xC0, 0xC1, 0xC2}  # baseline, extended sequential, progressive; Huffman-coded
_TABLES = {0xC4, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)}  # Huffman, quantisation, restart interval, comment, application


_BETWEEN_SCANS = _TABLES | {_START_OF_SCAN, 0xDC}  # and the number of lines


@dataclass(frozen=True, slots=True)
class AnnouncedPicture:
    """A picture that has not been decoded.

    Attributes:
        size: (width, height) in pixels, each at least 1.
        data: what to decode.
        transparent: whether pixels may be transparent.
        turned: whether a JPEG's Exif says that it is to be shown turned or mirrored.
    """

    size: tuple[int, int]
    data: bytes
    transparent: bool = False
    turned: bool = False


def announced_picture(data: bytes) -> AnnouncedPicture | None:
    """The picture in PNG or JPEG bytes, or None for anything else, for a part of one, and for an ambiguous header."""
    found = _png(data) if data.startswith(_PNG) else _jpeg(data) if data.startswith(_JPEG) else None
    return found if found is not None and min(found.size) > 0 else None


def _jpeg(data: bytes) -> AnnouncedPicture | None:
    """Walk the marker segments up to the first scan, and the scans up to the end; what lies behind is cut off.

    Behind may lie anything: a phone's film of the moment, a depth map, another picture.
    """
    at, size, turned = 2, None, False
    for _ in range(MAX_SEGMENTS):
        while data[at : at + 2] == b"\xff\xff":  # fill bytes
            at += 1
        if at + 4 > len(data) or data[at] != 0xFF:
            return None
        marker, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        if marker == _START_OF_SCAN:
            end = _end_of_scans(data, at)
            return AnnouncedPicture(size, data[:end], turned=turned) if size is not None and end is not None else None
        if length < 2 or at + 2 + length > len(data):
            return None
        if marker in _FRAME_HEADERS and size is None and length >= 8:
            height, width = struct.unpack_from(">HH", data, at + 5)
            size = width, height
        elif marker not in _TABLES:
            return None
        turned = turned or (marker == _EXIF_SEGMENT and _is_turned(data[at + 4 : at + 2 + length]))
        at += 2 + length
    return None


def _end_of_scans(data: bytes, at: int) -> int | None:
    """Where the picture ends whose first scan begins at `at`; None if it does not, or has too many scans."""
    scans = 0
    for _ in range(MAX_SEGMENTS):
        found = _MARKER.search(data, at)
        if found is None:
            return None
        marker = found.group(1)[0]
        scans += marker == _START_OF_SCAN
        if marker == _END_OF_IMAGE:
            return found.end()
        if scans > MAX_SCANS or marker not in _BETWEEN_SCANS or found.end() + 2 > len(data):
            return None
        at = found.end() + struct.unpack_from(">H", data, found.end())[0]
    return None


def _is_turned(segment: bytes) -> bool:
    """Whether the first directory of an Exif segment (CIPA DC-008) names another orientation than 1."""
    order = {b"Exif\0\0II*\0": "<", b"Exif\0\0MM\0*": ">"}.get(segment[:10])
    if order is None or len(segment) < 14:
        return False
    begin = 6 + struct.unpack_from(order + "I", segment, 10)[0] + 2
    for at in range(begin, len(segment) - 11, 12):
        tag, _, _, value = struct.unpack_from(order + "HHIH", segment, at)
        if tag >= _ORIENTATION:  # entries ascend
            return bool(tag == _ORIENTATION and 2 <= value <= 8)
    return False


def _png(data: bytes) -> AnnouncedPicture | None:
    """Walk the chunks, and keep those that hold pixels."""
    at, kept, size, transparent = len(_PNG), [_PNG], None, False
    for _ in range(MAX_CHUNKS):
        if at + 12 > len(data):
            return None
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data) or (kind == b"IHDR") != (size is None) or (kind == b"IHDR" and length != 13):
            return None
        if kind == b"IHDR":
            size = struct.unpack_from(">II", data, at + 8)
            transparent = data[at + 17] in _WITH_ALPHA
        transparent = transparent or kind == b"tRNS"
        if kind in _PNG_PIXELS:
            kept.append(data[at:end])
        if kind == b"IEND":
            return AnnouncedPicture((size[0], size[1]), b"".join(kept), transparent) if size is not None else None
        at = end
    return None
