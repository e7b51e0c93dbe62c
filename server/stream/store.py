"""Recordings on disk: one append-only `.slod` file for each group of pictures (GOP).

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
from streamlod.server.pipeline.spec import STREAM_ID
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


@dataclass(frozen=True, slots=True)
class Segment:
    """One group of pictures on disk.

    Attributes:
        path: its `.slod` file.
        first, last: positions of its keyframe and of its newest packet.
        packets, size_bytes: count and sum of sizes of its packets.
        begun_ns: Unix time of its keyframe; of a group of an earlier run as the times of its file and packets tell.
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
        InputError: the folder cannot be used.
    """

    def __init__(self, folder: Path, retention: Retention) -> None:
        self.folder, self.retention = folder, retention
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER)
            self._lock = _lock(folder)
            (folder / "streams").mkdir(exist_ok=True, mode=PRIVATE_FOLDER)
            self.seal = Seal(folder / "secret.key")
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

    def recording(self, stream: str) -> Recording:
        """The recording of a stream, repaired if the last run was interrupted; what fails is its `fault`."""
        recording = Recording(self, stream)
        self._recordings.append(recording)
        return recording

    def stored_streams(self) -> dict[str, StoredStream]:
        """Streams of which something is kept, by id; what else lies among them is reported."""
        found = {}
        for path in sorted((self.folder / "streams").iterdir()):
            if not (path.is_dir() and re.fullmatch(STREAM_ID, path.name)):
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
        """Finish queued work, close all open segments."""
        for recording in self._recordings:
            self._thread.submit(recording.finish)
        self._thread.shutdown(wait=True)
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
        except (OSError, StorageError) as error:
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
        except OSError as error:  # it can be read without its index, and is repaired at the next start
            self._stop(error)

    def _stop(self, error: Exception) -> None:
        self.fault = f"recording stopped: {getattr(error, 'strerror', None) or error}"  # without the file's name
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
        with contextlib.suppress(OSError):
            repaired = self._restored(segment.path)
        if repaired is not None:
            self.segments.append(repaired)

    def retain(self) -> None:
        """Delete closed segments that are too old or too much; the newest one stays. On the recording thread."""
        retention, now = self._store.retention, time.monotonic()
        total, old = sum(map(_kept_bytes, self.segments[-1:])), []
        for segment in reversed(self.segments[:-1]):
            total += _kept_bytes(segment)
            if total > retention.bytes or now - segment.begun > retention.seconds:
                old.append(segment)
        newest = self.segments[-1:]
        if newest and newest[0].closed and now - newest[0].begun > retention.seconds:
            old += newest
        try:
            self._delete(old)
        except OSError as error:
            _LOG.warning("stream %s: old segments cannot be deleted: %s", self._stream, error)

    def _delete(self, segments: list[Segment]) -> None:
        for segment in segments:
            _unlink(segment.path)
        self.segments = [s for s in self.segments if s not in segments]

    def _restore(self) -> list[Segment]:
        """Segments on disk; those that were cut short by a crash are repaired."""
        segments: list[Segment] = []
        for path in sorted(self._folder.iterdir()):
            if _SEGMENT.fullmatch(path.name) and path.is_file():
                segments += filter(None, [self._restored(path)])
            elif not _OWN_NAMES.fullmatch(path.name):
                _LOG.warning("stream %s: %s is none of its recordings and is left alone", self._stream, path)
        return segments

    def _restored(self, path: Path) -> Segment | None:
        """A segment on disk; where a crash cut it short, the incomplete packet is cut off and the index written.

        Without a whole keyframe: None, and no file, if it was cut short; a file that cannot be read is left alone.
        """
        written_ns = path.stat().st_mtime_ns
        try:
            with SlodReader(path) as reader:
                entries, is_whole = reader.entries, reader.is_whole
        except (BitstreamError, InputError, OSError) as error:
            entries, is_whole, fault = (), False, str(error)
        else:
            fault = "its first packet is no keyframe that this version knows"
        if not entries or entries[0].kind is not PacketKind.KEY:
            if _is_cut_short(path):
                _LOG.warning("stream %s: %s holds no whole keyframe and is deleted", self._stream, path.name)
                _unlink(path)
            else:
                _LOG.warning("stream %s: %s is left alone: %s", self._stream, path.name, fault)
            return None
        if not is_whole:
            try:
                SlodWriter(path, live=True).close()
                os.utime(path, ns=(written_ns, written_ns))
            except OSError as error:  # it can be read without; the next start tries again
                _LOG.warning("stream %s: %s cannot be repaired now (%s)", self._stream, path.name, error)
        epoch = int(path.stem.split("-")[0])
        first, last = Position(epoch, entries[0].to_version), Position(epoch, entries[-1].to_version)
        size = sum(entry.size_bytes for entry in entries)
        begun_ns = max(0, written_ns - max(0, entries[-1].time_ns - entries[0].time_ns))
        return Segment(path, first, last, len(entries), size, begun_ns, _monotonic(begun_ns), True)


def _kept_bytes(segment: Segment) -> int:
    """Bytes that retention counts: of its packets, and of the file of its sound as it is now."""
    try:
        return segment.size_bytes + sound_beside(segment.path).stat().st_size
    except OSError:  # no sound
        return segment.size_bytes


def _unlink(path: Path) -> None:
    """Delete a segment's files; its sound first, as nobody would look for sound without pictures after a crash."""
    for each in (sound_beside(path), path):
        each.unlink(missing_ok=True)


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
