"""Files that hold packets, whatever lies around these."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from streamlod.codec.container.layout import Entry, is_packet_of
from streamlod.codec.container.seek import way
from streamlod.codec.packet.bytes import HEADER_BYTES
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from streamlod.core.errors import BitstreamError, InputError


class PacketFile:
    """An open file of packets; subclasses know where these lie.

    Attributes:
        entries: the packets, in the order in which they were written.
        records_end: where the last complete packet ends, bytes from the file's start.
        torn: whether bytes follow that are neither a complete packet nor what ends such a file.

    Raises:
        InputError: the file cannot be opened.
        BitstreamError: it is of another kind or version.
    """

    entries: tuple[Entry, ...]
    records_end: int
    torn: bool

    def __init__(self, path: Path | str, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self._path, self._limits = Path(path), limits
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise InputError(path, f"it cannot be opened ({error.strerror})") from error
        try:
            self._size = self._file.seek(0, os.SEEK_END)
            self.entries, self.records_end, self.torn = self._look()
        except BaseException:
            self._file.close()
            raise

    @property
    def is_whole(self) -> bool:
        """Whether the file was written to its end."""
        return not self.torn

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

    def _look(self) -> tuple[tuple[Entry, ...], int, bool]:
        """`entries`, `records_end` and `torn` of the file."""
        raise NotImplementedError

    def _at(self, offset: int, count: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(count)
