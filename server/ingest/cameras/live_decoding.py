"""Decodes a live camera's pictures: none that was damaged on the way, or is built upon one that was."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

import av
import av.video.stream

from streamlod.core.data.video.reach import Reach
from streamlod.server.ingest.cameras.reports import media_ns_of

_LOG = logging.getLogger(__name__)
_USUAL_SECONDS = 12.0  # until the first keyframe; encoders left to themselves send one every 250 pictures
_PATIENCE_SECONDS = 60.0  # after which another connection may do better


class LiveDecoding:
    """One connection to a camera. B-pictures are not held back for the picture after them, as those of files are.

    Args:
        camera: name, for the log, which is told once.
        stream: what is decoded.
        missing: told, once, that the first keyframe does not come.
    """

    def __init__(self, camera: str, stream: av.video.stream.VideoStream, missing: Callable[[str], None]) -> None:
        self._camera, self._stream, self._missing = camera, stream, missing
        self._waits = True
        self._reach, self._told, self._since = Reach(), False, time.monotonic()

    def pictures(self, packet: av.Packet[Any]) -> list[av.VideoFrame]:
        """Pictures that are what was filmed.

        Raises:
            av.FFmpegError: nothing of what came for a while can be decoded.
        """
        right = self._pictures(packet)
        self._waits = self._waits and not right
        if self._waits and time.monotonic() - self._since > _USUAL_SECONDS:
            self._missing(f"sent no keyframe within {_USUAL_SECONDS:g} s; set it to send one each second or two")
            self._waits = False
        return right

    def _pictures(self, packet: av.Packet[Any]) -> list[av.VideoFrame]:
        if packet.pts is not None and packet.time_base is not None:
            self._reach.sample(packet, round(packet.pts * packet.time_base * 1_000_000_000))
        try:
            frames: Sequence[Any] | None = None if packet.is_corrupt else packet.decode()
        except av.InvalidDataError:
            if not self._reach.begun:  # opened amid a group of pictures: another connection would miss as much
                if time.monotonic() - self._since > _PATIENCE_SECONDS:
                    raise
                return []
            frames = None
        if frames is not None:
            self._reach.decoded()
            return self._right(frames)
        with contextlib.suppress(av.FFmpegError):
            frames = self._stream.decode(None)  # what it still has from before
        right = self._right(frames or ())
        self._stream.codec_context.flush_buffers()
        self._reach.forget()
        self._tell()
        return right

    def _right(self, frames: Sequence[Any]) -> list[av.VideoFrame]:
        right = []
        for frame in frames:
            assert isinstance(frame, av.VideoFrame)
            if frame.is_corrupt:
                if self._reach.begins_at(frame):
                    self._tell()
            elif not self._reach.includes(frame, media_ns_of(frame) or 0):
                right.append(frame)
        return right

    def _tell(self) -> None:
        if not self._told:
            fault = "camera %s: pictures are damaged on the way; up to the next keyframe, they are left out"
            _LOG.warning(fault, self._camera)
        self._told = True
