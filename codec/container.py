"""`.slod` files: packets one after the other, an index at the end. FORMAT.md section 15.

A file being written has no index; one that was torn lost it. Both are read by walking their records.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from codec.packet.info import PacketInfo, peek
from codec.packet.limits import DEFAULT_LIMITS, DecoderLimits
from codec.packet.packet import PacketKind
from core.errors import BitstreamError, InputError

_FILE_HEAD = b"SLOD\x01\x00\x00\x00"
_SIZE = struct.Struct("<I")
_INDEX_MARK = 0xFFFFFFFF
_INDEX_HEAD = struct.Struct("<II")
_ENTRY = struct.Struct("<QIIIIQBBHI")
_FOOTER = struct.Struct("<QI4s")
_FOOTER_MAGIC = b"SLIX"
COARSE_LEVELS = 3  # levels that make the first picture


@dataclass(frozen=True, slots=True)
class Entry:
    """One packet of a file.

    Attributes:
        offset: where the packet begins, bytes from the file's start.
        size_bytes: its length.
        kind, keyframe, from_version, to_version, time_ns, level_mask: as in the packet header.
        coarse_bytes: chunk bytes of levels 0 to 2.
    """

    offset: int
    size_bytes: int
    kind: PacketKind
    keyframe: int
    from_version: int
    to_version: int
    time_ns: int
    level_mask: int
    coarse_bytes: int


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
        # the process in the name: two writers of one file must not take each other's work
        self._written = self._path if live else self._path.with_name(f".{self._path.name}.{os.getpid()}.partial")
        self._entries: list[Entry] = []
        if live and self._path.exists() and self._path.stat().st_size > 0:
            with SlodReader(self._path) as reader:
                self._entries, end = list(reader.entries), reader.records_end
            self._file: BinaryIO = self._path.open("r+b")
            self._file.truncate(end)
            self._file.seek(end)
        else:
            self._file = self._written.open("wb")
            self._file.write(_FILE_HEAD)

    def append(self, packet: bytes) -> int:
        """Add a packet; returns its entry's number.

        Raises:
            BitstreamError: the packet's header is not valid.
        """
        info = peek(packet)
        self._entries.append(_entry(info, self._file.tell() + _SIZE.size))
        self._file.write(_SIZE.pack(len(packet)) + packet)
        if self._live:
            self._file.flush()
        return len(self._entries) - 1

    def close(self) -> None:
        """Write the index and give the file its name; a second call does nothing."""
        if self._file.closed:
            return
        at = self._file.tell()
        index = _INDEX_HEAD.pack(_INDEX_MARK, len(self._entries)) + b"".join(map(_pack_entry, self._entries))
        self._file.write(index + _FOOTER.pack(at, zlib.crc32(index), _FOOTER_MAGIC))
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._written.replace(self._path)

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


class SlodReader:
    """Reads a file, finished, live or torn.

    Attributes:
        entries: the packets, in the order in which they were written.
        records_end: where the last complete packet ends, bytes from the file's start.
        torn: whether bytes follow that are neither a complete packet nor an index.

    Raises:
        InputError: the file cannot be opened.
        BitstreamError: `bad_file`, it is not a `.slod` file.
    """

    def __init__(self, path: Path | str, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self._path, self._limits = Path(path), limits
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise InputError(path, f"it cannot be opened ({error.strerror})") from error
        try:
            self._size = self._file.seek(0, os.SEEK_END)
            if self._at(0, len(_FILE_HEAD)) != _FILE_HEAD:
                raise BitstreamError("bad_file", f"{self._path.name} does not begin like a .slod file")
            self.entries, self.records_end, self.torn = self._read_index() or self._walk()
        except BaseException:
            self._file.close()
            raise

    def read(self, number: int) -> bytes:
        """Packet `number`; BitstreamError `bad_file` if the file became shorter."""
        entry = self.entries[number]
        packet = self._at(entry.offset, entry.size_bytes)
        if len(packet) != entry.size_bytes:
            raise BitstreamError("bad_file", f"{self._path.name} ends inside packet {number}")
        return packet

    def packets(self) -> Iterator[bytes]:
        """All packets in order."""
        return (self.read(number) for number in range(len(self.entries)))

    def version_at(self, time_ns: int) -> int:
        """The version on show at `time_ns`: the last one not later, or the first of the file."""
        if not self.entries:
            raise InputError(self._path, "it holds no packet")
        shown = [e for e in self.entries if e.time_ns <= time_ns] or [min(self.entries, key=lambda e: e.time_ns)]
        return max(shown, key=lambda e: (e.time_ns, e.to_version)).to_version

    def plan(self, version: int) -> tuple[int, ...]:
        """Numbers of the packets that, decoded in this order from nothing, show `version` at the fewest bytes.

        Raises:
            InputError: no packets of the file lead there.
        """
        keys = [n for n, e in enumerate(self.entries) if e.kind is PacketKind.KEY and e.to_version <= version]
        keyframe = max((self.entries[n].keyframe for n in keys), default=-1)
        keys = [n for n in keys if self.entries[n].keyframe == keyframe]
        mask = 0
        for n in keys:
            mask |= self.entries[n].level_mask
        best: dict[int, tuple[int, tuple[int, ...]]] = {keyframe: (0, ())}
        edges = [n for n, e in enumerate(self.entries) if e.kind is not PacketKind.KEY and e.keyframe == keyframe]
        for n in sorted(edges, key=lambda n: self.entries[n].to_version):
            entry = self.entries[n]
            if entry.from_version in best and entry.level_mask & mask == mask:
                cost, path = best[entry.from_version]
                candidate = (cost + entry.size_bytes, (*path, n))
                best[entry.to_version] = min(best.get(entry.to_version, candidate), candidate)
        if not keys or version not in best:
            raise InputError(self._path, f"no packets lead to version {version}")
        return (*keys, *best[version][1])

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
        """The index at the file's end; None unless it is whole and every entry lies inside the file."""
        footer = self._at(max(0, self._size - _FOOTER.size), _FOOTER.size)
        if len(footer) < _FOOTER.size or footer[-4:] != _FOOTER_MAGIC:
            return None
        at, checksum, _ = _FOOTER.unpack(footer)
        length = self._size - _FOOTER.size - at
        if at < len(_FILE_HEAD) or length < _INDEX_HEAD.size:
            return None
        index = self._at(at, length)
        mark, count = _INDEX_HEAD.unpack_from(index)
        if zlib.crc32(index) != checksum or mark != _INDEX_MARK or length != _INDEX_HEAD.size + _ENTRY.size * count:
            return None
        try:
            entries = tuple(_unpack_entry(fields) for fields in _ENTRY.iter_unpack(index[_INDEX_HEAD.size :]))
        except ValueError:
            return None
        inside = all(e.offset + e.size_bytes <= at and e.size_bytes <= self._limits.packet_bytes for e in entries)
        return (entries, at, False) if inside else None

    def _walk(self) -> tuple[tuple[Entry, ...], int, bool]:
        """The entries of all complete packets from the file's start."""
        entries: list[Entry] = []
        at = len(_FILE_HEAD)
        while True:
            head = self._at(at, _SIZE.size)
            size = _SIZE.unpack(head)[0] if len(head) == _SIZE.size else _INDEX_MARK
            if size > min(self._limits.packet_bytes, self._size - at - _SIZE.size):
                return tuple(entries), at, at != self._size
            try:
                info = peek(self._at(at + _SIZE.size, size), self._limits)
            except BitstreamError:
                return tuple(entries), at, True
            entries.append(_entry(info, at + _SIZE.size))
            at += _SIZE.size + size


def _entry(info: PacketInfo, offset: int) -> Entry:
    return Entry(
        offset,
        info.size_bytes,
        info.kind,
        info.keyframe,
        info.from_version,
        info.to_version,
        info.time_ns,
        info.level_mask,
        sum(info.level_bytes[:COARSE_LEVELS]),
    )


def _pack_entry(e: Entry) -> bytes:
    versions = (e.keyframe, e.from_version, e.to_version)
    return _ENTRY.pack(e.offset, e.size_bytes, *versions, e.time_ns, e.kind, 0, e.level_mask, e.coarse_bytes)


def _unpack_entry(fields: tuple[int, ...]) -> Entry:
    offset, size, keyframe, start, end, time_ns, kind, _, mask, coarse = fields
    return Entry(offset, size, PacketKind(kind), keyframe, start, end, time_ns, mask, coarse)
