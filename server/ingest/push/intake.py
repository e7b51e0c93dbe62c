"""Takes the pictures of a capture node: determines their capture time, and decodes pixels only when they are used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import av
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.data.announced import AnnouncedPicture, announced_picture
from streamlod.core.data.pictures import decode
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.picture_size import check_size, max_pixels
from streamlod.server.ingest.push.message import SOUND_CODECS, Codec, PushMessage
from streamlod.server.ingest.push.sound import PushedSound
from streamlod.server.ingest.rig import Rig
from streamlod.server.ingest.sync.clock import CaptureClock, CaptureTime, Sighting
from streamlod.server.ingest.sync.picture import Picture, one_at_a_time


class Intake:
    """Turns one capture node's messages into a rig's pictures.

    Args:
        rig: that takes them.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._newest: dict[str, int] = {}
        self._clocks: dict[str, CaptureClock] = {}
        self._decoders: dict[str, av.VideoCodecContext] = {}
        self._sounds: dict[str, PushedSound] = {}
        self._refused: set[str] = set()  # cameras of which a picture was refused

    def accept(self, message: PushMessage) -> None:
        """Give the message's picture or sound to the rig; a repeated one is ignored.

        Raises:
            InputError: no such camera is pushed, another node has taken it over, or the picture is not one, or of
                another size than calibrated.
        """
        size = self._rig.pushed.get(message.camera)
        if size is None:
            raise InputError(f"camera {message.camera!r:.80}", "is not one of the rig's that are pushed")
        if message.codec in SOUND_CODECS:
            self._hear(message)
            return
        try:
            self._accept(message, size)
        except InputError as error:
            if message.camera not in self._newest or self._rig.holders.holds(message.camera, self):
                self._refused.add(message.camera)
                self._rig.findings.note_decoded(message.camera, error.fault)
            raise

    def _accept(self, message: PushMessage, size: tuple[int, int]) -> None:
        still = None if message.codec is Codec.H264 else _announced(message, size)
        if message.camera not in self._newest:
            self._rig.holders.claim(message.camera, self)
            self._newest[message.camera] = -1
        if not self._rig.holders.holds(message.camera, self):
            raise InputError(f"camera {message.camera}", "is sent by another phone or capture node now")
        if message.sequence <= self._newest[message.camera]:
            return
        found = self._time(message)
        if still is None:
            self._decode(message, size, found)
        elif found is not None:
            camera = message.camera
            self._put(camera, found.capture_ns, found, lambda: _pixels(still, camera))
        self._newest[message.camera] = message.sequence

    def _hear(self, message: PushMessage) -> None:
        """Sound counts only beside pictures, so that it is of who holds the camera."""
        camera = message.camera
        if not self._rig.sound.hears(camera):
            raise InputError(f"camera {camera}", "is not the one whose sound the rig wants")
        if not self._rig.holders.holds(camera, self):
            return
        sound = self._sounds.setdefault(camera, PushedSound(camera))
        for frame, capture_ns in sound.decoded(message, self._rig.now_ns):
            self._rig.sound.put(frame, capture_ns)

    def wanted(self) -> dict[str, Any]:
        """The rig's rate as `fps`, and `cameras` that are pushed: name, width, height, whether one is `taken`,
        whether its `sound` is wanted, a `complaint` of its times, place or name if there is one, and while a board's
        walk is recorded what it sees of the `board`."""
        rig, held = self._rig, self._rig.holders.is_held
        cameras = [
            {"name": name, "width": width, "height": height, "taken": held(name), "sound": rig.sound.hears(name)}
            | ({"complaint": said} if (said := rig.complaint(name)) else {})
            | ({} if (sight := rig.sight(name)) is None else {"board": asdict(sight)})
            for name, (width, height) in rig.pushed.items()
        ]
        return {"fps": rig.fps, "cameras": cameras}

    def close(self) -> None:
        """The capture node has gone, and what was refused of it is no fault of who comes next under its names."""
        held = [name for name in self._newest if self._rig.holders.holds(name, self)]
        for camera in {*held, *(name for name in self._refused if not self._rig.holders.is_held(name))}:
            self._rig.findings.note_decoded(camera)
        for camera in held:
            self._rig.gone(camera, "its phone or capture node has disconnected", ended=False)

    def _time(self, message: PushMessage) -> CaptureTime | None:
        arrival = self._rig.now_ns
        clock = self._clocks.get(message.camera)
        if clock is None:
            epoch = 0 if message.capture_ns is not None else self._rig.genlock_epoch_ns(message.sequence)
            clock = self._clocks[message.camera] = CaptureClock(self._rig.fps, epoch)
        number = message.sequence if message.capture_ns is None else None
        return clock.capture(Sighting(arrival, stated_ns=message.capture_ns, frame_number=number))

    def _decode(self, message: PushMessage, size: tuple[int, int], found: CaptureTime | None) -> None:
        """Decode one access unit; its picture may come with a later one, and is dropped if it has no time."""
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
            check_size(message.camera, (frame.width, frame.height), size)
            if found is None or frame.pts is None:
                continue

            def load(frame: av.VideoFrame = frame) -> UInt8:
                return np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)

            self._put(message.camera, frame.pts, found, one_at_a_time(load))

    def _put(self, camera: str, capture_ns: int, found: CaptureTime, load: Callable[[], UInt8]) -> None:
        self._rig.put(Picture(camera, capture_ns, found.source, found.error_ns, load))


def _announced(message: PushMessage, size: tuple[int, int]) -> AnnouncedPicture:
    picture = announced_picture(message.body)
    if picture is None:
        raise InputError(f"camera {message.camera}", f"sent no {message.codec.upper()} picture, or part of one")
    check_size(message.camera, picture.size, size)
    return picture


def _pixels(picture: AnnouncedPicture, camera: str) -> UInt8:
    pixels = decode(picture)
    if pixels is None:
        raise InputError(f"camera {camera}", "sent a picture that does not decode")
    return pixels


def _h264_decoder(size: tuple[int, int]) -> av.VideoCodecContext:
    context = av.CodecContext.create("h264", "r")
    assert isinstance(context, av.VideoCodecContext)
    context.thread_count = 1
    context.options = {"max_pixels": str(max_pixels(size))}
    return context
