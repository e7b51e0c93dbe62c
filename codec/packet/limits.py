"""Limits that a decoder checks before it allocates. FORMAT.md section 13."""

from __future__ import annotations

from dataclasses import dataclass

from streamlod.core.errors import BitstreamError

MAX_NUMBERS_A_BYTE = 64  # part of the format, not of one decoder: rows x columns of a table, for each byte of its level


@dataclass(frozen=True, slots=True)
class DecoderLimits:
    """Upper bounds, checked before memory is taken; a stream that needs more is refused with `limit_exceeded`.

    Those of a player, by default: complexity level `main`.

    Attributes:
        packet_bytes: length of one packet.
        levels: octree levels.
        anchors: rows of all levels together.
        gaussians: rows of all levels together, times the Gaussians of an anchor.
        state_bytes: memory of all rows together.
        gaussians_per_anchor, features: K and F of the header.
        cameras: cameras of the header.
    """

    packet_bytes: int = 16 << 20
    levels: int = 16
    anchors: int = 1 << 18
    gaussians: int = 1 << 21
    state_bytes: int = 64 << 20
    gaussians_per_anchor: int = 16
    features: int = 64
    cameras: int = 255

    def rows(self, row_bytes: int, slots: int) -> int:
        """The most rows of `row_bytes` and `slots` Gaussians each that all levels may have together."""
        return min(self.anchors, self.gaussians // slots, self.state_bytes // row_bytes)


COMPLEXITY_LEVELS = {
    "small": DecoderLimits(anchors=1 << 16, gaussians=1 << 19, state_bytes=16 << 20),
    "main": DecoderLimits(),
    "large": DecoderLimits(anchors=1 << 20, gaussians=1 << 24, state_bytes=256 << 20),
}
DEFAULT_LIMITS = COMPLEXITY_LEVELS["main"]


@dataclass(frozen=True, slots=True)
class Room:
    """The room that is left for the chunks of one level.

    Attributes:
        rows: rows that may be added to the state.
        level_bytes: length of all chunks of this level in the packet.
    """

    rows: int
    level_bytes: int

    def check_added(self, rows: int, columns: int) -> None:
        """Refuse a table of new rows that is beyond the state's limit, or that has too few bytes behind it."""
        if rows > self.rows:
            raise BitstreamError("limit_exceeded", f"{rows} rows exceed the limit of {self.rows} more")
        self.check(rows, columns)

    def check(self, rows: int, columns: int) -> None:
        """Refuse a table of `rows` x `columns` numbers that has too few bytes behind it."""
        if rows * columns > MAX_NUMBERS_A_BYTE * self.level_bytes:
            raise BitstreamError("limit_exceeded", f"{self.level_bytes} bytes cannot carry {rows} x {columns} numbers")
