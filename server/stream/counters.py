"""Counters of a stream."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Counters:
    """Totals of one stream."""

    packets: int = 0
    packet_bytes: int = 0
    sent_bytes: int = 0
    skips: int = 0
    stuck: int = 0
    joins: int = 0
    pictures: int = 0
    picture_bytes: int = 0
    picture_seconds: float = 0.0
    thin_refused: int = 0
