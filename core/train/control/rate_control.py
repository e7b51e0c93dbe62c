"""Rate control: predicted packets that fit a channel of constant rate, as a video encoder does it.

A leaky bucket models the channel's buffer: each packet pours in, the rate drains it. Two means hold it: the weight of
the rate term doubles with every eighth that the bucket is too full, and the number of anchors that a frame may change
is limited to what still fits, so that no burst overflows it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from streamlod.core.train.config import PredictConfig

_DOUBLINGS = 8.0  # of the rate weight, from the wanted fill to one bucket above it
_WANTED_FILL = 0.3  # of the bucket: room for a burst above, something to drain below
_STRAINED = 2.0  # factor of the rate weight from which quality visibly gives way
_OVERHEAD = 40  # bytes of a packet that changes nothing
_FORGET = 0.3  # weight of the latest packet in the bytes an anchor takes
_FIRST_GUESS = 8.0  # bytes an anchor, before any packet was seen
_CHANGES_A_NEW = 5  # changed anchors that take as many bytes as one that is added
_NEW_SHARE = 0.1  # of a packet, which added anchors may take


@dataclass(frozen=True, slots=True)
class RatePlan:
    """The bits and anchors that the next frame may spend.

    Attributes:
        weight_factor: of the configured rate weight.
        most_anchors: that may change.
    """

    weight_factor: float
    most_anchors: int

    @property
    def strained(self) -> bool:
        """Whether quality gives way so far that it has to be made good later."""
        return self.weight_factor >= _STRAINED

    @property
    def most_new(self) -> int:
        """Anchors that may be added."""
        return int(_NEW_SHARE * self.most_anchors / _CHANGES_A_NEW)

    def most_changes_beside(self, new: int) -> int:
        """Anchors that may change where `new` are added."""
        return max(self.most_anchors - _CHANGES_A_NEW * new, 0)

    def applied(self, config: PredictConfig) -> PredictConfig:
        """`config` under this plan: where packets are too large, bits weigh more and only surer anchors are trained."""
        surer = 1 - 1 / max(self.weight_factor, 1.0)
        return replace(
            config,
            rate_weight=config.rate_weight * self.weight_factor,
            posterior=config.posterior + (1 - config.posterior) * surer,
        )


UNLIMITED = RatePlan(1.0, 1 << 40)
"""As many bytes as a frame takes."""


class RateControl:
    """Holds a stream to a rate.

    Args:
        kbps: kilobits (1000 bits) a second, more than 0.
        fps: frames a second, more than 0.
    """

    def __init__(self, kbps: float, fps: float) -> None:
        self._drain = kbps * 1000 / 8 / fps  # bytes a frame
        # a second of it: the delay that a viewer on this channel sees at worst
        self._capacity = max(kbps * 1000 / 8, self._drain)
        self._held = _WANTED_FILL * self._capacity
        self._bytes_per_anchor = _FIRST_GUESS

    @property
    def fill(self) -> float:
        """How full the bucket is, 0 to 1; above 1 it has overflowed."""
        return self._held / self._capacity

    def plan(self) -> RatePlan:
        """For the next frame."""
        room = self._capacity - max(self._held - self._drain, 0.0) - _OVERHEAD
        doublings = _DOUBLINGS * (min(self.fill, 1.0) - _WANTED_FILL)
        return RatePlan(2.0**doublings, max(int(room / self._bytes_per_anchor), 0))

    def sent(self, size_bytes: int, anchors: int) -> None:
        """Learn that the latest predicted packet has `size_bytes` and changed so many `anchors`."""
        self._held = max(self._held - self._drain, 0.0) + size_bytes
        if anchors:
            share = max(size_bytes - _OVERHEAD, 1) / anchors
            # believed at once when it rises: the limit on anchors must hold now
            new = max(share, self._bytes_per_anchor + _FORGET * (share - self._bytes_per_anchor))
            self._bytes_per_anchor = new

    def sent_keyframe(self, size_bytes: int) -> None:
        """Learn of a keyframe: it may fill the bucket, and what is beyond is written off, for nothing could save it."""
        self._held = min(self._held + size_bytes, self._capacity)
