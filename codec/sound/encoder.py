"""Opus made of sound as it comes."""

from __future__ import annotations

import av
import numpy as np

from streamlod.codec.sound.opus import BITS_A_SECOND, LAYOUTS, SAMPLE_RATE, audio_frame
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, samples_in, settings_of
from streamlod.core.arrays import Int16

_MAX_SILENCE = SAMPLE_RATE  # samples that are missing, for which silence is encoded; after more, it begins anew


class SoundEncoder:
    """Encodes blocks of samples, in packets of 20 ms that follow one another.

    Where samples are missing there is silence, of a second at most; what comes a second time is left out.

    Args:
        channels: 1 or 2.

    Attributes:
        settings: of the packets.
    """

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._next: int | None = None  # number of the sample to come
        self._open()

    def put(self, block: Int16, begin: int) -> list[OpusPacket]:
        """The packets that are complete with a block [N, channels], whose first sample has the number `begin`."""
        done: list[OpusPacket] = []
        if self._next is not None and begin - self._next > _MAX_SILENCE:
            done = self._packets(None)
            self._open()
        if self._next is None:
            self._next = self._first = begin
        block = block[max(0, self._next - begin) :]
        if len(block) == 0:
            return done
        missing = max(0, begin - self._next)
        whole = np.concatenate([np.zeros((missing, self._channels), np.int16), block])
        frame = audio_frame(whole, self._next - self._first)
        self._next += len(whole)
        return done + self._packets(frame)

    def _open(self) -> None:
        context = self._context = av.CodecContext.create("libopus", "w")
        context.sample_rate, context.layout, context.format = SAMPLE_RATE, LAYOUTS[self._channels], "s16"
        context.bit_rate, context.options = BITS_A_SECOND[self._channels], {"frame_duration": "20"}
        context.open()
        self.settings: OpusSettings = settings_of(bytes(context.extradata or b""))
        self._next, self._first = None, 0

    def _packets(self, frame: av.AudioFrame | None) -> list[OpusPacket]:
        found = []
        for packet in self._context.encode(frame):
            data = bytes(packet)
            time = self._first + (packet.pts or 0) + self.settings.pre_skip
            found.append(OpusPacket(time, samples_in(data), data))
        return found
