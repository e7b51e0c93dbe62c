"""Reading `.slod` files.

A file that is still being written has no index yet; one whose writer was killed lost it. Both are read by walking
their records.
"""

from __future__ import annotations

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
    lie_in_order,
)
from streamlod.codec.container.packet_file import PacketFile
from streamlod.codec.packet.info import peek
from streamlod.core.errors import BitstreamError


class SlodReader(PacketFile):
    """Reads a file that is complete, still being written, or cut short.

    Raises:
        InputError: the file cannot be opened.
        BitstreamError: `bad_file`, it is not a `.slod` file; `unsupported_version`, it is one of another version.
    """

    @property
    def is_whole(self) -> bool:
        """Whether the file was closed, and nothing of it is lost."""
        return not self.torn and self.records_end < self._size

    def _look(self) -> tuple[tuple[Entry, ...], int, bool]:
        check_head(self._at(0, len(FILE_HEAD)), self._path.name)
        return self._read_index() or self._walk()

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
