"""Pictures that capture nodes push: one binary message each, parsed before anything is decoded. No I/O in here.

A message is the header's length (2 bytes, big-endian), the header (a msgpack map) and the encoded picture:

    camera      name in the rig's definition
    sequence    counts the camera's pictures; a number that isn't higher than the last is a repeat and is skipped
    capture_ns  when it was taken, nanoseconds since 1970; null where `sequence` is a genlocked rig's frame number
    codec       jpeg, png, or h264 (one access unit, Annex B, parameter sets before each keyframe)
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import av
import cv2
import msgpack
import numpy as np

from core.arrays import UInt8
from core.data.pictures import encoded_size
from core.errors import InputError, SessionError
from server.ingest.clock import CaptureClock, CaptureTime, ClockSource, Sighting
from server.ingest.picture import Picture
from server.messages import BAD_MESSAGE

MAX_MESSAGE_BYTES = 16 << 20
_TOO_BIG = 1009  # RFC 6455 section 7.4.1
_MAX_HEADER_BYTES = 512
_FIELDS = {"camera", "sequence", "capture_ns", "codec"}
_MOST_NUMBER, _MOST_TIME = 2**53, 2**62


class Codec(StrEnum):
    """How a pushed picture is encoded."""

    JPEG = "jpeg"
    PNG = "png"
    H264 = "h264"


@dataclass(frozen=True, slots=True)
class PushMessage:
    """One pushed picture: see the module; `body` is the encoded picture."""

    camera: str
    sequence: int
    capture_ns: int | None
    codec: Codec
    body: bytes


def parse_push(message: bytes) -> PushMessage:
    """Read a message without decoding its picture.

    Raises:
        SessionError: longer than 16 MiB, or not of the form described in the module.
    """
    if len(message) > MAX_MESSAGE_BYTES:
        raise SessionError(_TOO_BIG, f"a picture may have {MAX_MESSAGE_BYTES} bytes at most")
    if len(message) < 2:
        raise SessionError(BAD_MESSAGE, "the message ends before its header")
    (length,) = struct.unpack_from(">H", message)
    if not 1 <= length <= _MAX_HEADER_BYTES or 2 + length >= len(message):
        raise SessionError(BAD_MESSAGE, f"a header has 1 to {_MAX_HEADER_BYTES} bytes, and a picture follows it")
    try:
        fields = msgpack.unpackb(
            message[2 : 2 + length], max_str_len=128, max_map_len=8, max_array_len=0, max_bin_len=0, max_ext_len=0
        )
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        raise SessionError(BAD_MESSAGE, "the header is not a msgpack map") from error
    return _checked(fields, message[2 + length :])


def _checked(fields: Any, body: bytes) -> PushMessage:
    if not isinstance(fields, dict) or set(fields) != _FIELDS:
        raise SessionError(BAD_MESSAGE, "a header holds camera, sequence, capture_ns and codec")
    camera, sequence, capture, codec = (fields[name] for name in ("camera", "sequence", "capture_ns", "codec"))
    if not isinstance(camera, str):
        raise SessionError(BAD_MESSAGE, "camera must be a name")
    if not _is_number(sequence, _MOST_NUMBER):
        raise SessionError(BAD_MESSAGE, "sequence must be a number from 0 to 2^53")
    if capture is not None and not _is_number(capture, _MOST_TIME):
        raise SessionError(BAD_MESSAGE, "capture_ns must be null or nanoseconds since 1970")
    if codec not in set(Codec):
        raise SessionError(BAD_MESSAGE, "codec must be jpeg, png or h264")
    return PushMessage(camera, sequence, capture, Codec(codec), body)


def _is_number(value: object, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def pack_push(message: PushMessage) -> bytes:
    """The bytes of a message, as a capture node sends them; `parse_push` goes back."""
    fields = {
        "camera": message.camera,
        "sequence": message.sequence,
        "capture_ns": message.capture_ns,
        "codec": str(message.codec),
    }
    header: bytes = msgpack.packb(fields)
    return struct.pack(">H", len(header)) + header + message.body


class PushTarget(Protocol):
    """The rig that pushed pictures are for."""

    @property
    def fps(self) -> float:
        """Instants a second."""

    @property
    def now_ns(self) -> int:
        """The present, on the rig's timeline."""

    @property
    def pushed(self) -> Mapping[str, tuple[int, int]]:
        """(width, height) of each camera that is pushed."""

    def genlock_epoch_ns(self, number: int) -> int:
        """When frame number 0 was taken, given that `number` came just now, if it is the rig's first."""

    def put(self, picture: Picture) -> None:
        """A picture has come."""

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        """A camera delivers nothing for now."""


class Intake:
    """Makes a rig's pictures of one capture node's messages.

    Args:
        target: the rig.
    """

    def __init__(self, target: PushTarget) -> None:
        self._target = target
        self._newest: dict[str, int] = {}
        self._clocks: dict[str, CaptureClock] = {}
        self._decoders: dict[str, av.VideoCodecContext] = {}

    def accept(self, message: PushMessage) -> None:
        """Hand the message's picture on; nothing happens for a repeat.

        Raises:
            InputError: no such camera is pushed, or the picture is not one, or of another size than calibrated.
        """
        size = self._target.pushed.get(message.camera)
        if size is None:
            raise InputError(f"camera {message.camera!r:.80}", "is not one of the rig's that are pushed")
        if message.codec is not Codec.H264:
            _check_size(message, size)
        if message.sequence <= self._newest.get(message.camera, -1):
            return
        found = self._time(message)
        if message.codec is Codec.H264:
            self._decode(message, size, found)
        elif found is not None:
            body, camera = message.body, message.camera
            self._put(message, size, found.capture_ns, found, lambda: _pixels(body, camera, size))
        self._newest[message.camera] = message.sequence

    def close(self) -> None:
        """The capture node has gone."""
        for camera in self._newest:
            self._target.gone(camera, "its capture node has disconnected", ended=False)

    def _time(self, message: PushMessage) -> CaptureTime | None:
        arrival = self._target.now_ns
        clock = self._clocks.get(message.camera)
        if clock is None:
            epoch = 0 if message.capture_ns is not None else self._target.genlock_epoch_ns(message.sequence)
            clock = self._clocks[message.camera] = CaptureClock(self._target.fps, epoch)
        number = message.sequence if message.capture_ns is None else None
        return clock.capture(Sighting(arrival, stated_ns=message.capture_ns, frame_number=number))

    def _decode(self, message: PushMessage, size: tuple[int, int], found: CaptureTime | None) -> None:
        """Decode one access unit; its picture may come with a later one; without a time it is let go."""
        decoder = self._decoders.get(message.camera)
        if decoder is None:
            decoder = self._decoders[message.camera] = _h264_decoder(size)
        packet = av.Packet(message.body)
        packet.pts = None if found is None else found.capture_ns
        try:
            frames = decoder.decode(packet)
        except av.FFmpegError as error:
            raise InputError(f"camera {message.camera}", "sent H.264 that does not decode") from error
        for frame in frames:
            if (frame.width, frame.height) != size:
                raise _wrong_size(message.camera, (frame.width, frame.height), size)
            if found is None or frame.pts is None:
                continue

            def load(frame: av.VideoFrame = frame) -> UInt8:
                return np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)

            self._put(message, size, frame.pts, found, load)

    def _put(self, message: PushMessage, size: tuple[int, int], capture: int, found: CaptureTime, load: Any) -> None:
        source: ClockSource = found.source
        self._target.put(Picture(message.camera, capture, source, found.error_ns, message.sequence, size, load))


def _check_size(message: PushMessage, size: tuple[int, int]) -> None:
    found = encoded_size(message.body)
    if found is None:
        raise InputError(f"camera {message.camera}", f"sent something that is no {message.codec.upper()} picture")
    if found != size:
        raise _wrong_size(message.camera, found, size)


def _wrong_size(camera: str, found: tuple[int, int], size: tuple[int, int]) -> InputError:
    fault = f"delivers {found[0]}x{found[1]}, but is calibrated for {size[0]}x{size[1]}"
    return InputError(f"camera {camera}", fault)


def _pixels(body: bytes, camera: str, size: tuple[int, int]) -> UInt8:
    picture = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None or picture.shape != (size[1], size[0], 3):
        raise InputError(f"camera {camera}", "sent a picture that does not decode")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)


def _h264_decoder(size: tuple[int, int]) -> av.VideoCodecContext:
    context = av.CodecContext.create("h264", "r")
    assert isinstance(context, av.VideoCodecContext)
    context.thread_count = 1
    context.options = {"max_pixels": str((size[0] + 64) * (size[1] + 64))}
    return context
