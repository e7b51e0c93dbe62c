"""Writing `.slod` files, packet by packet."""

from __future__ import annotations

from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Self

from streamlod.codec.container.layout import FILE_HEAD, SIZE, Entry, entry_of, file_end, record
from streamlod.codec.container.reader import SlodReader
from streamlod.codec.packet.info import peek
from streamlod.core.files import put_in_place, temporary_beside


class SlodWriter:
    """Writes a file, packet by packet.

    Normally under a temporary name that becomes `path` on `close`; leaving the context by an exception removes it.
    With `live`, at `path` itself; an existing file is continued after its last complete packet. Every packet is handed
    to the operating system at once, whole or not at all.

    Raises:
        InputError: the existing file is not a `.slod` file.
        OSError: no room, or another fault of the disk; what was written before can be read.
    """

    def __init__(self, path: Path | str, live: bool = False) -> None:
        self._path, self._live = Path(path), live
        self._written = self._path if live else temporary_beside(self._path)
        self._entries: list[Entry] = []
        if live and self._path.exists() and self._path.stat().st_size > 0:
            with SlodReader(self._path) as reader:
                self._entries, end = list(reader.entries), reader.records_end
            self._file: FileIO = self._path.open("r+b", buffering=0)
            self._file.truncate(end)
            self._file.seek(end)
        else:
            self._file = self._written.open("wb", buffering=0)
            try:
                self._write(FILE_HEAD)
            except OSError:
                self._drop()
                raise

    def append(self, packet: bytes) -> int:
        """Add a packet; returns its entry's number.

        Raises:
            BitstreamError: the packet's header is not valid.
        """
        entry = entry_of(peek(packet), self._file.tell() + SIZE.size)
        self._write(record(packet))
        self._entries.append(entry)
        return len(self._entries) - 1

    def close(self) -> None:
        """Write the index and give the file its name; a second call does nothing.

        A disk without room for the index leaves the file without, and is told of where it is `live`.
        """
        if self._file.closed:
            return
        try:
            self._write(file_end(self._entries, self._file.tell()))
        except OSError:
            if self._live:
                raise
        finally:
            self._file.close()
            put_in_place(self._written, self._path)

    def _write(self, data: bytes) -> None:
        """Write all of `data`, or nothing."""
        begin, left = self._file.tell(), memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._file.seek(begin)
            self._file.truncate()
            raise OSError(error.errno, error.strerror, str(self._path)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or self._live:
            self.close()
        elif not self._file.closed:
            self._drop()

    def _drop(self) -> None:
        self._file.close()
        if not self._live:
            self._written.unlink(missing_ok=True)
