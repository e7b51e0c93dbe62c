"""METADATA: tagged facts about a scene. FORMAT.md section 2.1."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from streamlod.core.scene.exposures import CameraExposure
from streamlod.core.scene.metadata import Metadata, Original

_FIELD = struct.Struct("<HH")  # tag, length
_LENGTH, _DIRECTION, _TIME, _SIMILARITY = (struct.Struct(form) for form in ("<d", "<3d", "<q", "<8d"))
_EXPOSURE = struct.Struct("<6f")


def _original(data: bytes) -> Original:
    scale, w, x, y, z, *translation = _SIMILARITY.unpack(data)
    return Original(scale, (w, x, y, z), (translation[0], translation[1], translation[2]))


def _exposures(data: bytes) -> tuple[CameraExposure, ...]:
    return tuple(CameraExposure((r, g, b), (x, y, z)) for r, g, b, x, y, z in _EXPOSURE.iter_unpack(data))


_TAGS: tuple[tuple[int, str, Callable[[Any], bytes], Callable[[bytes], Any]], ...] = (
    (1, "metres_per_unit", _LENGTH.pack, lambda data: _LENGTH.unpack(data)[0]),
    (2, "up", lambda up: _DIRECTION.pack(*up), _DIRECTION.unpack),
    (3, "epoch_ns", _TIME.pack, lambda data: _TIME.unpack(data)[0]),
    (4, "title", str.encode, bytes.decode),
    (5, "licence", str.encode, bytes.decode),
    (6, "original", lambda o: _SIMILARITY.pack(o.scale, *o.rotation, *o.translation), _original),
    (7, "exposures", lambda found: b"".join(_EXPOSURE.pack(*e.gain, *e.offset) for e in found), _exposures),
)


def encode_metadata(metadata: Metadata) -> bytes:
    """The METADATA chunk."""
    parts = []
    for tag, name, pack, _ in _TAGS:
        if (value := getattr(metadata, name)) is not None:
            content = pack(value)
            parts.append(_FIELD.pack(tag, len(content)) + content)
    return b"".join(parts)


def decode_metadata(data: bytes) -> Metadata:
    """The content of a METADATA chunk; nothing in it is refused, and what cannot be read counts as absent."""
    known = {tag: (name, read) for tag, name, _, read in _TAGS}
    values: dict[str, Any] = {}
    before, at = -1, 0
    while at + _FIELD.size <= len(data):
        tag, length = _FIELD.unpack_from(data, at)
        at += _FIELD.size + length
        if tag <= before or at > len(data):
            break
        before = tag
        if tag in known:
            name, read = known[tag]
            try:
                value = read(data[at - length : at])
                Metadata(**{name: value})
            except (ValueError, struct.error):
                continue
            values[name] = value
    return Metadata(**values)
