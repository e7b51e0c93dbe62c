"""Pictures and sound that capture nodes push: one binary message each, parsed before anything is decoded. No I/O here.

A message is the header's length (2 bytes, big-endian), the header (a msgpack map) and the encoded picture or sound:

    camera      name in the rig's definition
    sequence    counts the camera's pictures; a number that isn't higher than the last is a repeat and is skipped
    capture_ns  when it was taken, nanoseconds since 1970; null where `sequence` is a genlocked rig's frame number
    codec       jpeg, png, or h264 (one access unit, Annex B, parameter sets before each keyframe);
                of sound opus (one packet) or pcm (16 bits, little-endian, one channel, 48 kHz), which have numbers of
                their own, and `capture_ns` of the first sample
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import msgpack

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError

PUSH_SUBPROTOCOL = "streamlod.push.v1"
MAX_MESSAGE_BYTES = 16 << 20
_MAX_HEADER_BYTES = 512
_FIELDS = {"camera", "sequence", "capture_ns", "codec"}
_MAX_SEQUENCE, _MAX_CAPTURE_NS = 2**53, 2**62


class Codec(StrEnum):
    """How a pushed picture is encoded."""

    JPEG = "jpeg"
    PNG = "png"
    H264 = "h264"
    OPUS = "opus"
    PCM = "pcm"


SOUND_CODECS = frozenset({Codec.OPUS, Codec.PCM})


@dataclass(frozen=True, slots=True)
class PushMessage:
    """One pushed picture, or sound.

    Attributes:
        camera, sequence, capture_ns, codec: the header's fields, see the module.
        body: the encoded picture or sound.
        received: the whole message as it came, to be passed on; None for one that was made here.
    """

    camera: str
    sequence: int
    capture_ns: int | None
    codec: Codec
    body: bytes
    received: bytes | None = field(default=None, compare=False, repr=False)


def parse_push(message: bytes) -> PushMessage:
    """Read a message without decoding its picture.

    Raises:
        SessionError: longer than 16 MiB, or not of the form described in the module.
    """
    if len(message) > MAX_MESSAGE_BYTES:
        raise SessionError(CloseCode.TOO_BIG, f"a message may have {MAX_MESSAGE_BYTES} bytes at most")
    if len(message) < 2:
        raise SessionError(CloseCode.BAD_MESSAGE, "the message ends before its header")
    (length,) = struct.unpack_from(">H", message)
    if not 1 <= length <= _MAX_HEADER_BYTES or 2 + length >= len(message):
        raise SessionError(
            CloseCode.BAD_MESSAGE, f"a header has 1 to {_MAX_HEADER_BYTES} bytes, and a picture follows it"
        )
    try:
        fields = msgpack.unpackb(
            message[2 : 2 + length], max_str_len=128, max_map_len=8, max_array_len=0, max_bin_len=0, max_ext_len=0
        )
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        raise SessionError(CloseCode.BAD_MESSAGE, "the header is not a msgpack map") from error
    return _checked(fields, message, 2 + length)


def _checked(fields: Any, message: bytes, header: int) -> PushMessage:
    """The message with the header `fields`, which end at byte `header`."""
    if not isinstance(fields, dict) or set(fields) != _FIELDS:
        raise SessionError(CloseCode.BAD_MESSAGE, "a header holds camera, sequence, capture_ns and codec")
    camera, sequence, capture, codec = (fields[name] for name in ("camera", "sequence", "capture_ns", "codec"))
    if not isinstance(camera, str):
        raise SessionError(CloseCode.BAD_MESSAGE, "camera must be a name")
    if not _is_number(sequence, _MAX_SEQUENCE):
        raise SessionError(CloseCode.BAD_MESSAGE, "sequence must be an integer from 0 to 2^53")
    if capture is not None and not _is_number(capture, _MAX_CAPTURE_NS):
        raise SessionError(CloseCode.BAD_MESSAGE, "capture_ns must be null or an integer, nanoseconds since 1970")
    if codec not in set(Codec):
        raise SessionError(CloseCode.BAD_MESSAGE, f"codec must be one of {', '.join(Codec)}")
    return PushMessage(camera, sequence, capture, Codec(codec), message[header:], message)


def _is_number(value: object, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def pack_push(message: PushMessage) -> bytes:
    """The bytes of a message, as a capture node sends them; `parse_push` goes back."""
    if message.received is not None:
        return message.received
    fields = {
        "camera": message.camera,
        "sequence": message.sequence,
        "capture_ns": message.capture_ns,
        "codec": str(message.codec),
    }
    header: bytes = msgpack.packb(fields)
    return struct.pack(">H", len(header)) + header + message.body
