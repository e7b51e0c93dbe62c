"""Recordings on disk: one append-only `.slod` file for each group of pictures (GOP), and a catalogue of them.

All writing happens on one thread. A packet goes to viewers when it is written, so that a recording holds whatever a
viewer got (see `server.stream.bus`). Live streaming survives a failure: a full disk stops the recording and is
reported, and the next keyframe tries again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import shutil
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.container.layout import FILE_HEAD, SIZE
from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.packet.packet import PacketKind
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.packets import PacketWriter
from streamlod.core.errors import BitstreamError, InputError, StorageError
from streamlod.server.protocol.packets import Position, StreamPacket
from streamlod.server.settings import Retention
from streamlod.server.stream.sealing import Seal
from streamlod.server.stream.stored_stream import (
    PRIVATE_FILE,
    PRIVATE_FOLDER,
    STORED_NAME,
    StoredStream,
    read_stored,
    write_stored,
)

_LOG = logging.getLogger(__name__)
_T = TypeVar("_T")
_SEGMENT = re.compile(r"(\d{6,10})-(\d{10})\.slod")
_OWN_NAMES = re.compile(r"stream\.(json|new|damaged)|\d{6,10}-\d{10}\.slod\.opus")
_STREAM = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_SCHEMA = """
CREATE TABLE IF NOT EXISTS segments(
  stream TEXT NOT NULL, epoch INTEGER NOT NULL, first INTEGER NOT NULL, last INTEGER NOT NULL,
  packets INTEGER NOT NULL, bytes INTEGER NOT NULL, begun_ns INTEGER NOT NULL, file_bytes INTEGER NOT NULL,
  PRIMARY KEY(stream, epoch, first));
"""
_COLUMNS = "stream, epoch, first, last, packets, bytes, begun_ns, file_bytes"


@dataclass(frozen=True, slots=True)
class Segment:
    """One group of pictures on disk.

    Attributes:
        path: its `.slod` file.
        first, last: positions of its keyframe and of its newest packet.
        packets, size_bytes: count and sum of sizes of its packets.
        begun_ns: Unix time of its keyframe.
        begun: monotonic time of its keyframe [s]; used for retention, as the system clock may be set.
        closed: whether it has its index and will not change.
    """

    path: Path
    first: Position
    last: Position
    packets: int
    size_bytes: int
    begun_ns: int
    begun: float
    closed: bool


class Store:
    """All recordings below one folder.

    Args:
        folder: made if it is missing.
        retention: what to keep.

    Raises:
        InputError: the folder or its catalogue cannot be used.
    """

    def __init__(self, folder: Path, retention: Retention) -> None:
        self.folder, self.retention = folder, retention
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER)
            self._lock = _lock(folder)
            (folder / "streams").mkdir(exist_ok=True, mode=PRIVATE_FOLDER)
            self.seal = Seal(folder / "secret.key")
            self._catalogue = _open_catalogue(folder / "catalogue.sqlite3")
        except OSError as error:
            fault = f"cannot hold recordings ({error.strerror or error})"
            mend = f"give the folder to user {os.getuid()}, or " if isinstance(error, PermissionError) else ""
            raise InputError(folder, f"{fault}; {mend}choose another --state-dir") from error
        self._recordings: list[Recording] = []
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")

    async def run(self, work: Callable[[], _T]) -> _T:
        """Do `work` on the recording thread."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def submit(self, work: Callable[[], None]) -> Future[None]:
        """Do `work` on the recording thread, later."""
        return self._thread.submit(work)

    def execute(self, statement: str, values: tuple[Any, ...]) -> list[tuple[Any, ...]]:
        """One catalogue statement, committed."""
        with self._catalogue:
            return self._catalogue.execute(statement, values).fetchall()

    def recording(self, stream: str) -> Recording:
        """The recording of a stream, repaired if the last run was interrupted; what fails is its `fault`."""
        recording = Recording(self, stream)
        self._recordings.append(recording)
        return recording

    def stored_streams(self) -> dict[str, StoredStream]:
        """Streams of which something is kept, by id; what else lies among them is reported."""
        found = {}
        for path in sorted((self.folder / "streams").iterdir()):
            if not (path.is_dir() and _STREAM.fullmatch(path.name)):
                _LOG.warning("%s is no stream's folder and is left alone", path)
            elif (stored := read_stored(path)) is not None:
                found[path.name] = stored
        return found

    def forget(self, recording: Recording) -> None:
        """Close a recording no more with the others."""
        self._recordings.remove(recording)

    @property
    def has_room(self) -> bool:
        """Whether the disk has more left than its reserve."""
        usage = shutil.disk_usage(self.folder)
        return usage.free > usage.total * self.retention.reserve_fraction

    def close(self) -> None:
        """Finish queued work, close all open segments and the catalogue."""
        for recording in self._recordings:
            self._thread.submit(recording.finish)
        self._thread.shutdown(wait=True)
        self._catalogue.close()
        os.close(self._lock)

    def retain(self) -> None:
        """Delete what has become too old, soon; to be called now and then, as a stream may get no packets."""
        for recording in self._recordings:
            self._thread.submit(recording.retain)


class Recording:
    """The recording of one stream; `segments` is what can be read, oldest first."""

    def __init__(self, store: Store, stream: str) -> None:
        self._store, self._stream = store, stream
        self._folder = store.folder / "streams" / stream
        self._writer: SlodWriter | None = None
        self._sound: PacketWriter | None = None  # of the open segment, once there is sound
        self._sound_fails = False
        self._waiting_bytes = 0
        self._noting = threading.Lock()
        self.fault: str | None = None
        self.lost_packets = 0
        self.stored = read_stored(self._folder) or StoredStream(created_ns=time.time_ns())
        self.segments = self._restore() if self._folder.exists() else []

    @property
    def last_epoch(self) -> int:
        """Highest epoch that was ever used, or 0."""
        return max(self.stored.epoch, self.segments[-1].first.epoch if self.segments else 0)

    def note(self, **changes: Any) -> None:
        """Remember fields of `StoredStream` that have changed.

        Raises:
            StorageError: the disk is full or cannot be written; nothing has changed.
        """
        with self._noting:
            stored = replace(self.stored, **changes)
            if stored != self.stored or not (self._folder / STORED_NAME).exists():
                write_stored(self._folder, stored)
                self.stored = stored

    def append(self, packet: StreamPacket) -> Future[None] | None:
        """Queue a packet for recording, or drop it if the disk is far behind; what is done when it is written."""
        if self._waiting_bytes > self._store.retention.memory_bytes:
            self.fault, self.lost_packets = "the disk is too slow", self.lost_packets + 1
            self._store.submit(self._abandon)
            return None
        self._waiting_bytes += len(packet.data)
        return self._store.submit(lambda: self._write(packet))

    def append_sound(self, pieces: Sequence[SoundPiece]) -> None:
        """Queue sound for the file beside the open segment; without one it is left out."""
        if self._waiting_bytes <= self._store.retention.memory_bytes:
            self._store.submit(lambda: self._write_sound(pieces))

    async def flush(self) -> None:
        """Wait until everything appended so far is written."""
        await self._store.run(lambda: None)

    async def close(self) -> None:
        """Finish the open segment."""
        await self._store.run(self.finish)

    async def delete(self, firsts: Collection[Position]) -> None:
        """Delete the closed segments that begin at these positions."""

        def work() -> None:
            self._delete([s for s in self.segments if s.closed and s.first in firsts])

        await self._store.run(work)

    async def erase(self) -> None:
        """Delete everything."""

        def work() -> None:
            self.finish()
            self._delete(list(self.segments))
            shutil.rmtree(self._folder, ignore_errors=True)

        await self._store.run(work)
        self._store.forget(self)

    def _write(self, packet: StreamPacket) -> None:
        """Append to the open segment; a keyframe begins one. On the recording thread."""
        self._waiting_bytes -= len(packet.data)
        try:
            if packet.is_key:
                self.finish()
                self.retain()
                self._begin(packet)
            if self._writer is None:
                self.lost_packets += 1
                return
            self._writer.append(packet.data)
        except (OSError, sqlite3.Error, StorageError) as error:
            self.lost_packets += 1
            self._stop(error)
            self._abandon()
            return
        last = self.segments[-1]
        size = last.size_bytes + len(packet.data)
        self.segments[-1] = replace(last, last=packet.position, packets=last.packets + 1, size_bytes=size)
        self.fault = None

    def _write_sound(self, pieces: Sequence[SoundPiece]) -> None:
        """Append to the sound of the open segment, of which a failure is reported once. On the recording thread."""
        if self._writer is None or self._sound_fails:
            return
        path = sound_beside(self.segments[-1].path)
        try:
            if self._sound is None:
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE_FILE))
                self._sound = PacketWriter(path, pieces[0].settings, pieces[0].packets[0].time)
            for piece in pieces:
                for packet in piece.packets:
                    self._sound.append(packet)
        except OSError as error:
            self._sound_fails = True
            _LOG.error("stream %s: sound is not recorded before the next keyframe: %s", self._stream, error)

    def _finish_sound(self) -> None:
        sound, self._sound, self._sound_fails = self._sound, None, False
        if sound is not None:
            with contextlib.suppress(OSError):  # it can be read up to where it was written
                sound.close()

    def _begin(self, packet: StreamPacket) -> None:
        if not self._store.has_room:
            raise OSError("the disk is full except for its reserve")
        self.note()  # it may be the first that is written of this stream, or the first that the disk takes
        path = self._folder / f"{packet.position.epoch:06d}-{packet.position.version:010d}.slod"
        if path.exists():
            raise OSError(f"{path.name} exists already")
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE_FILE))
        self._writer = SlodWriter(path, live=True)
        now = time.time_ns(), time.monotonic()
        self.segments.append(Segment(path, packet.position, packet.position, 0, 0, *now, False))

    def finish(self) -> None:
        """Close the open segment. On the recording thread."""
        self._finish_sound()
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.close()
            self.segments[-1] = replace(self.segments[-1], closed=True)
            self._enter(self.segments[-1])
        except (OSError, sqlite3.Error) as error:  # it can be read without its index, and is repaired at the next start
            self._stop(error)

    def _stop(self, error: Exception) -> None:
        self.fault = f"recording stopped: {error}"
        _LOG.error("stream %s: %s", self._stream, self.fault)

    def _abandon(self) -> None:
        """Give up the open segment, keeping it up to its last whole packet."""
        self._finish_sound()
        writer, self._writer = self._writer, None
        if writer is None:
            return
        with contextlib.suppress(OSError):
            writer.close()
        segment = self.segments.pop()
        repaired = None
        with contextlib.suppress(OSError, sqlite3.Error):
            repaired = self._repair(segment.path, segment.begun_ns)
        if repaired is not None:
            self.segments.append(repaired)

    def retain(self) -> None:
        """Delete closed segments that are too old or too much; the newest one stays. On the recording thread."""
        retention, now = self._store.retention, time.monotonic()
        total = sum(s.size_bytes for s in self.segments[-1:])
        old = []
        for segment in reversed(self.segments[:-1]):
            total += segment.size_bytes
            if total > retention.bytes or now - segment.begun > retention.seconds:
                old.append(segment)
        newest = self.segments[-1:]
        if newest and newest[0].closed and now - newest[0].begun > retention.seconds:
            old += newest
        try:
            self._delete(old)
        except (OSError, sqlite3.Error) as error:
            _LOG.warning("stream %s: old segments cannot be deleted: %s", self._stream, error)

    def _delete(self, segments: list[Segment]) -> None:
        for segment in segments:
            for path in (segment.path, sound_beside(segment.path)):
                path.unlink(missing_ok=True)
            key = (self._stream, segment.first.epoch, segment.first.version)
            self._store.execute("DELETE FROM segments WHERE stream = ? AND epoch = ? AND first = ?", key)
        self.segments = [s for s in self.segments if s not in segments]

    def _enter(self, s: Segment) -> None:
        place = (self._stream, s.first.epoch, s.first.version, s.last.version)
        values = (*place, s.packets, s.size_bytes, s.begun_ns, s.path.stat().st_size)
        self._store.execute("INSERT OR REPLACE INTO segments VALUES (?, ?, ?, ?, ?, ?, ?, ?)", values)

    def _restore(self) -> list[Segment]:
        """Segments on disk; those that differ from the catalogue were cut short by a crash and are repaired."""
        statement = "SELECT epoch, first, last, packets, bytes, begun_ns, file_bytes FROM segments WHERE stream = ?"
        known = {(row[0], row[1]): row for row in self._store.execute(statement, (self._stream,))}
        segments = []
        for path in sorted(self._folder.iterdir()):
            match = _SEGMENT.fullmatch(path.name)
            if match is None or not path.is_file():
                if not _OWN_NAMES.fullmatch(path.name):
                    _LOG.warning("stream %s: %s is none of its recordings and is left alone", self._stream, path)
                continue
            epoch, first = int(match[1]), int(match[2])
            row = known.pop((epoch, first), None)
            stat = path.stat()
            if row is not None and row[6] == stat.st_size:
                place = Position(epoch, first), Position(epoch, row[2])
                segments.append(Segment(path, *place, row[3], row[4], row[5], _monotonic(row[5]), True))
                continue
            segments += filter(None, [self._repair(path, stat.st_mtime_ns)])
        with contextlib.suppress(sqlite3.Error):
            for epoch, first in known:
                statement = "DELETE FROM segments WHERE stream = ? AND epoch = ? AND first = ?"
                self._store.execute(statement, (self._stream, epoch, first))
        return segments

    def _repair(self, path: Path, begun_ns: int) -> Segment | None:
        """Cut off an incomplete packet and write the index, where these are not as they should be.

        Without a whole keyframe: None, and no file, if it was cut short; a file that cannot be read is left alone.
        """
        try:
            with SlodReader(path) as reader:
                entries = reader.entries
                is_whole = not reader.torn and reader.records_end < path.stat().st_size
        except (BitstreamError, InputError, OSError) as error:
            entries, is_whole, fault = (), False, str(error)
        else:
            fault = "its first packet is no keyframe that this version knows"
        if not entries or entries[0].kind is not PacketKind.KEY:
            if _is_cut_short(path):
                _LOG.warning("stream %s: %s holds no whole keyframe and is deleted", self._stream, path.name)
                for each in (path, sound_beside(path)):
                    each.unlink(missing_ok=True)
            else:
                _LOG.warning("stream %s: %s is left alone: %s", self._stream, path.name, fault)
            return None
        epoch = int(path.stem.split("-")[0])
        first, last = Position(epoch, entries[0].to_version), Position(epoch, entries[-1].to_version)
        size = sum(entry.size_bytes for entry in entries)
        segment = Segment(path, first, last, len(entries), size, begun_ns, _monotonic(begun_ns), True)
        try:
            if not is_whole:
                SlodWriter(path, live=True).close()
                os.utime(path, ns=(begun_ns, begun_ns))
            self._enter(segment)
        except (OSError, sqlite3.Error) as error:  # it can be read without; the next start tries again
            _LOG.warning("stream %s: %s cannot be repaired now (%s)", self._stream, path.name, error)
        return segment


def _is_cut_short(path: Path) -> bool:
    """Whether a file ends before its first packet does, as its size says; False where it cannot be read."""
    try:
        with path.open("rb") as file:
            start = file.read(len(FILE_HEAD) + SIZE.size)
        head, size = start[: len(FILE_HEAD)], start[len(FILE_HEAD) :]
        if len(size) < SIZE.size:
            return FILE_HEAD.startswith(head)
        return head == FILE_HEAD and len(start) + SIZE.unpack(size)[0] > path.stat().st_size
    except OSError:
        return False


def _open_catalogue(path: Path) -> sqlite3.Connection:
    """The catalogue; one that is damaged or of another version is set aside, and made again from the files.

    Where the disk takes none, it is in memory: all it saves is looking into the files.
    """
    try:
        try:
            return _catalogue_at(path)
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError) and "no such column" not in str(error):
                raise  # the disk is full, or cannot be read or written
            _LOG.warning("%s cannot be used (%s); it is kept as %s.damaged and made again", path, error, path.stem)
            for suffix in ("-wal", "-shm"):
                path.with_name(path.name + suffix).unlink(missing_ok=True)
            path.replace(path.with_suffix(".damaged"))
            return _catalogue_at(path)
    except (OSError, sqlite3.OperationalError) as error:
        _LOG.warning("%s cannot be opened (%s); until the next start there is one in memory", path, error)
        return _catalogue_at(":memory:")


def _catalogue_at(path: Path | str) -> sqlite3.Connection:
    if isinstance(path, Path):
        os.close(os.open(path, os.O_CREAT | os.O_WRONLY, PRIVATE_FILE))
        path.chmod(PRIVATE_FILE)  # what SQLite keeps beside it gets the same
    connection = sqlite3.connect(path, check_same_thread=False)
    try:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.executescript(_SCHEMA)
        connection.execute(f"SELECT {_COLUMNS} FROM segments").fetchall()  # all, which finds what is damaged
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _lock(folder: Path) -> int:
    """A descriptor that holds the folder for this process; a second server on one folder would tear its files."""
    descriptor = os.open(folder / "lock", os.O_CREAT | os.O_RDWR, PRIVATE_FILE)
    if sys.platform == "win32":  # which has no such locks
        return descriptor
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise InputError(folder, "is used by another server; stop it, or choose another --state-dir") from error
    return descriptor


def _monotonic(unix_ns: int) -> float:
    """The monotonic time of an earlier Unix time, by the clock as it is set now."""
    return time.monotonic() - max(0, time.time_ns() - unix_ns) / 1e9
