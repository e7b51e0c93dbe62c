"""Sound that a capture node pushes, decoded."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np

from streamlod.codec.sound.packets import samples_in
from streamlod.core.errors import InputError
from streamlod.server.ingest.push.message import Codec, PushMessage
from streamlod.server.ingest.sync.clock import PLAUSIBLE_NS

_RATE = 48_000
_MAX_BYTES = 2 * _RATE  # of a message: a second of samples, and more than any packet of Opus
_SECOND_NS = 1_000_000_000


class PushedSound:
    """Decodes the sound of one camera.

    Args:
        camera: its name.
    """

    def __init__(self, camera: str) -> None:
        self._subject = f"camera {camera}"
        self._newest = -1
        self._opus: av.AudioCodecContext | None = None

    def decoded(self, message: PushMessage, now_ns: int) -> list[tuple[av.AudioFrame, int]]:
        """Frames of a message with their capture times; none where it is a repeat.

        Raises:
            InputError: it is no sound, too long, or its time is impossible.
        """
        if message.sequence <= self._newest:
            return []
        if message.capture_ns is None:
            raise InputError(self._subject, "sent sound without a time")
        if abs(late_ns := now_ns - message.capture_ns) >= PLAUSIBLE_NS:
            seconds, most = abs(late_ns) / _SECOND_NS, PLAUSIBLE_NS // _SECOND_NS
            which = "late" if late_ns > 0 else "early"
            raise InputError(self._subject, f"sent sound {seconds:.0f} s too {which}, of which {most} s are allowed")
        if len(message.body) > _MAX_BYTES:
            raise InputError(self._subject, f"sent sound of more than {_MAX_BYTES} bytes")
        frames = self._samples(message.body) if message.codec is Codec.PCM else self._packet(message.body)
        self._newest = message.sequence
        found, capture_ns = [], message.capture_ns
        for frame in frames:
            found.append((frame, capture_ns))
            capture_ns += frame.samples * _SECOND_NS // frame.sample_rate
        return found

    def _samples(self, body: bytes) -> list[av.AudioFrame]:
        if len(body) % 2:
            raise InputError(self._subject, "sent half a sample")
        frame = av.AudioFrame.from_ndarray(np.frombuffer(body, "<i2").astype(np.int16)[None], "s16", "mono")
        frame.sample_rate, frame.time_base = _RATE, Fraction(1, _RATE)
        return [frame]

    def _packet(self, body: bytes) -> list[av.AudioFrame]:
        if self._opus is None:
            self._opus = av.CodecContext.create("libopus", "r")
            self._opus.sample_rate, self._opus.layout = _RATE, "mono"
        try:
            samples_in(body)
            return self._opus.decode(av.Packet(body))
        except (av.FFmpegError, ValueError) as error:
            raise InputError(self._subject, "sent Opus that does not decode") from error
