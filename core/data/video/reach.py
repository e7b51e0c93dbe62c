"""How far damage reaches: decoders conceal it as well as they can, and go on with what came of it."""

from __future__ import annotations

from typing import Any

import av


class Reach:
    """Which decoded pictures are what was filmed.

    Damage ends with the next keyframe. Where an intra refresh stands for keyframes, one has to pass as a whole, as the
    decoder does not tell when its pictures are right again.

    Attributes:
        begun: whether a picture was right.
    """

    def __init__(self) -> None:
        self.begun = False
        self._lost = False
        self._empty = True  # the decoder has nothing that a refresh could begin upon
        self._keys: list[int] = []  # times of keyframes and refreshes that began after the damage

    def sample(self, packet: av.Packet[Any], time_ns: int) -> None:
        """Note what will be decoded, and its time."""
        if packet.is_keyframe and self._lost and not self._empty:
            self._keys.append(time_ns)

    def decoded(self) -> None:
        """Note that the decoder took a sample."""
        self._empty = False

    def forget(self) -> None:
        """Note that a sample could not be decoded, and that the decoder was made to forget all before it."""
        self._empty = True
        self._begin()

    def begins_at(self, frame: av.VideoFrame) -> bool:
        """Whether there is damage from this picture on, which the decoder marks: not where nothing was right before, as
        a refresh with which a file begins is not complete yet."""
        if self.begun or frame.key_frame:
            self._begin()
            return True
        return False

    def includes(self, frame: av.VideoFrame, time_ns: int) -> bool:
        """Whether damage reaches a picture that the decoder does not mark."""
        self._lost = self._lost and not frame.key_frame and (len(self._keys) < 2 or time_ns < self._keys[1])
        self.begun = self.begun or not self._lost
        return self._lost

    def _begin(self) -> None:
        self._lost, self._keys = True, []
