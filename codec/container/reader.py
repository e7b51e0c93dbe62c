"""Reading `.slod` files.

A file that is still being written has no index yet; one whose writer was killed lost it. Both are read by walking
their records.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from streamlod.codec.container.layout import (
    FILE_HEAD,
    FOOTER,
    FOOTER_MAGIC,
    INDEX_MARK,
    SIZE,
    Entry,
    check_head,
    entries_in,
    entry_of,
    is_packet_of,
    lie_in_order,
)
from streamlod.codec.container.seek import way
from streamlod.codec.packet.bytes import HEADER_BYTES
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.core.errors import BitstreamError, InputError


class SlodReader:
    """Reads a file that is complete, still being written, or cut short.

    Attributes:
        entries: the packets, in the order in which they were written.
        records_end: where the last complete packet ends, bytes from the file's start.
        torn: whether bytes follow that are neither a complete packet nor an index.

    Raises:
        InputError: the file cannot be opened.
        BitstreamError: `bad_file`, it is not a `.slod` file; `unsupported_version`, it is one of another version.
    """

    def __init__(self, path: Path | str, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self._path, self._limits = Path(path), limits
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise InputError(path, f"it cannot be opened ({error.strerror})") from error
        try:
            self._size = self._file.seek(0, os.SEEK_END)
            check_head(self._at(0, len(FILE_HEAD)), self._path.name)
            self.entries, self.records_end, self.torn = self._read_index() or self._walk()
        except BaseException:
            self._file.close()
            raise

    def read(self, number: int) -> bytes:
        """Packet `number`; BitstreamError `bad_file` if the file became shorter, or the index says otherwise of it."""
        entry = self.entries[number]
        packet = self._at(entry.offset, entry.size_bytes)
        if len(packet) != entry.size_bytes:
            raise BitstreamError("bad_file", f"{self._path.name} ends inside packet {number}")
        if len(packet) < HEADER_BYTES or not is_packet_of(entry, packet):
            raise BitstreamError(
                "bad_file", f"the index of {self._path.name} contradicts the header of packet {number}"
            )
        return packet

    def packets(self) -> Iterator[bytes]:
        """All packets in order."""
        return (self.read(number) for number in range(len(self.entries)))

    def plan(self, version: int) -> tuple[int, ...]:
        """Numbers of the packets that, decoded in this order from nothing, show `version` at the fewest bytes.

        Raises:
            InputError: no packets of the file lead there.
        """
        path = way(self.entries, version)
        if path is None:
            raise InputError(self._path, f"no packets lead to version {version}")
        return path

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _at(self, offset: int, count: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(count)

    def _read_index(self) -> tuple[tuple[Entry, ...], int, bool] | None:
        """The index at the file's end; None unless it is whole and its packets lie in order before it."""
        footer = self._at(max(0, self._size - FOOTER.size), FOOTER.size)
        if len(footer) < FOOTER.size or footer[-4:] != FOOTER_MAGIC:
            return None
        at, checksum, _ = FOOTER.unpack(footer)
        length = self._size - FOOTER.size - at
        entries = entries_in(self._at(at, length), checksum) if at >= len(FILE_HEAD) and length > 0 else None
        if entries is None:
            return None
        short = all(entry.size_bytes <= self._limits.packet_bytes for entry in entries)
        return (entries, at, False) if short and lie_in_order(entries, at) else None

    def _walk(self) -> tuple[tuple[Entry, ...], int, bool]:
        """The entries of all complete packets from the file's start."""
        entries: list[Entry] = []
        at = len(FILE_HEAD)
        while True:
            head = self._at(at, SIZE.size)
            size = SIZE.unpack(head)[0] if len(head) == SIZE.size else INDEX_MARK
            if size > min(self._limits.packet_bytes, self._size - at - SIZE.size):
                return tuple(entries), at, at != self._size
            try:
                info = peek(self._at(at + SIZE.size, size), self._limits)
            except BitstreamError:
                return tuple(entries), at, True
            entries.append(entry_of(info, at + SIZE.size))
            at += SIZE.size + size
