"""What a decoder accepts before it allocates."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DecoderLimits:
    """Upper bounds, checked before memory is taken; a stream that needs more is refused with `limit_exceeded`.

    Attributes:
        packet_bytes: length of one packet.
        levels: octree levels.
        anchors: rows of all levels together.
        gaussians_per_anchor, features: K and F of the header.
        cameras: cameras of the header.
    """

    packet_bytes: int = 16 << 20
    levels: int = 16
    anchors: int = 1 << 20
    gaussians_per_anchor: int = 16
    features: int = 64
    cameras: int = 255


DEFAULT_LIMITS = DecoderLimits()
