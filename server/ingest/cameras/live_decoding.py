"""Decodes a live camera's pictures: none that was damaged on the way, or is built upon one that was."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Sequence
from typing import Any

import av
import av.video.stream

from streamlod.core.data.video.reach import Reach
from streamlod.server.ingest.cameras.reports import media_ns_of

_LOG = logging.getLogger(__name__)
_PATIENCE_SECONDS = 12.0  # until the first keyframe; encoders left to themselves send one every 250 pictures


class LiveDecoding:
    """One connection to a camera. B-pictures are not held back for the picture after them, as those of files are.

    Args:
        camera: name, for the log, which is told once.
        stream: what is decoded.
    """

    def __init__(self, camera: str, stream: av.video.stream.VideoStream) -> None:
        self._camera, self._stream = camera, stream
        self._reach, self._told, self._since = Reach(), False, time.monotonic()

    def pictures(self, packet: av.Packet[Any]) -> list[av.VideoFrame]:
        """Pictures that are what was filmed.

        Raises:
            av.FFmpegError: nothing of what came for a while can be decoded.
        """
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
