"""Writing `.slod` files, packet by packet."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from streamlod.codec.container.layout import FILE_HEAD, SIZE, Entry, entry_of, file_end, record
from streamlod.codec.container.reader import SlodReader
from streamlod.codec.packet.info import peek
from streamlod.core.files import put_in_place, temporary_beside


class SlodWriter:
    """Writes a file, packet by packet.

    Normally under a temporary name that becomes `path` on `close`; leaving the context by an exception removes it.
    With `live`, at `path` itself, every packet handed to the operating system at once; an existing file is continued
    after its last complete packet.

    Raises:
        InputError: the existing file is not a `.slod` file.
    """

    def __init__(self, path: Path | str, live: bool = False) -> None:
        self._path, self._live = Path(path), live
        self._written = self._path if live else temporary_beside(self._path)
        self._entries: list[Entry] = []
        if live and self._path.exists() and self._path.stat().st_size > 0:
            with SlodReader(self._path) as reader:
                self._entries, end = list(reader.entries), reader.records_end
            self._file: BinaryIO = self._path.open("r+b")
            self._file.truncate(end)
            self._file.seek(end)
        else:
            self._file = self._written.open("wb")
            self._file.write(FILE_HEAD)

    def append(self, packet: bytes) -> int:
        """Add a packet; returns its entry's number.

        Raises:
            BitstreamError: the packet's header is not valid.
        """
        self._entries.append(entry_of(peek(packet), self._file.tell() + SIZE.size))
        self._file.write(record(packet))
        if self._live:
            self._file.flush()
        return len(self._entries) - 1

    def close(self) -> None:
        """Write the index and give the file its name; a second call does nothing."""
        if self._file.closed:
            return
        self._file.write(file_end(self._entries, self._file.tell()))
        self._file.close()
        put_in_place(self._written, self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or self._live:
            self.close()
        elif not self._file.closed:
            self._file.close()
            self._written.unlink(missing_ok=True)
