"""Packets of fewer levels, cut out of whole ones without decoding anything. FORMAT.md section 2."""

from __future__ import annotations

from dataclasses import replace

from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.packet import Packet


def select_levels(packet: bytes, mask: int) -> bytes:
    """The packet with the levels of bit mask `mask` only; nothing is decoded.

    Raises:
        BitstreamError: the packet is not valid.
        ValueError: no level would remain.
    """
    return build(_select(parse(packet, verify=False), mask))


def drop_levels(packet: bytes, highest_level: int) -> bytes:
    """The packet without levels finer than `highest_level`; errors as in `select_levels`."""
    return select_levels(packet, (1 << highest_level + 1) - 1)


def split_levels(packet: bytes) -> tuple[bytes, ...]:
    """One packet a level, coarse first; header and weights are part of level 0.

    Raises:
        BitstreamError: the packet is not valid.
    """
    whole = parse(packet, verify=False)
    return tuple(build(_select(whole, 1 << level)) for level in whole.levels)


def _select(packet: Packet, mask: int) -> Packet:
    kept = packet.level_mask & mask
    if kept == 0:
        raise ValueError(f"no level of the packet (mask {packet.level_mask:#x}) would remain with mask {mask:#x}")
    return replace(packet, level_mask=kept, chunks=tuple(c for c in packet.chunks if kept >> c.level & 1))
