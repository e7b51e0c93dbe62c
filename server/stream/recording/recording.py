"""The recording of one stream: an append-only `.slod` file for each group of pictures, and sound beside it.

All writing happens on one thread. A packet goes to viewers when it is written, so that a recording holds whatever a
viewer got (see `server.stream.bus`). Live streaming survives a failure: a full disk stops the recording and is
reported, and the next keyframe tries again.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import shutil
import threading
import time
from collections.abc import Collection, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from streamlod.codec.container import SlodWriter
from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.packets import PacketWriter
from streamlod.core.errors import StorageError
from streamlod.server.protocol.packets import Position, StreamPacket
from streamlod.server.stream.recording.disk import Disk
from streamlod.server.stream.recording.segment import Segment, dated, restored, unlink
from streamlod.server.stream.recording.stored_stream import (
    PRIVATE_FILE,
    STORED_NAME,
    StoredStream,
    read_stored,
    write_stored,
)

_LOG = logging.getLogger(__name__)
_SEGMENT = re.compile(r"(\d{6,10})-(\d{10})\.slod")
_OWN_NAMES = re.compile(r"stream\.(json|new|damaged)|\d{6,10}-\d{10}\.slod\.opus")


class Recording:
    """The recording of one stream; what fails is its `fault`.

    Attributes:
        segments: what can be read, oldest first.
        fault: why nothing is recorded now, in a sentence; None while all is well.
        lost_packets: that are not in it.
        stored: what is remembered of the stream.
        is_erased: whether it was deleted as a whole.

    Args:
        disk: that holds it; what an interrupted run left there is repaired.
        stream: its id.
    """

    def __init__(self, disk: Disk, stream: str) -> None:
        self._disk, self._stream = disk, stream
        self._folder = disk.streams / stream
        self._writer: SlodWriter | None = None
        self._sound: PacketWriter | None = None  # of the open segment, once there is sound
        self._sound_fails = self.is_erased = False
        self._is_behind = False  # whether packets were dropped that follow those which wait
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
        if self._waiting_bytes > self._disk.retention.memory_bytes:
            self.lost_packets += 1
            self._is_behind = True
            self._fail("the disk is too slow")
            self._disk.submit(self._catch_up)
            return None
        self._waiting_bytes += len(packet.data)
        return self._disk.submit(lambda: self._write(packet))

    def append_sound(self, pieces: Sequence[SoundPiece], camera: str | None) -> None:
        """Queue sound that is heard at `camera`, if at one, for the file beside the open segment, if there is one."""
        if self._waiting_bytes <= self._disk.retention.memory_bytes:
            self._disk.submit(lambda: self._write_sound(pieces, camera))

    async def flush(self) -> None:
        """Wait until everything appended so far is written."""
        await self._disk.run(lambda: None)

    async def close(self) -> None:
        """Finish the open segment."""
        await self._disk.run(self.finish)

    async def delete(self, firsts: Collection[Position]) -> None:
        """Delete the closed segments that begin at these positions."""

        def work() -> None:
            self._delete([s for s in self.segments if s.closed and s.first in firsts])

        await self._disk.run(work)

    async def erase(self) -> None:
        """Delete everything."""

        def work() -> None:
            self.finish()
            self._delete(list(self.segments))
            shutil.rmtree(self._folder, ignore_errors=True)

        await self._disk.run(work)
        self.is_erased = True

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
        if packet.is_key and self.fault is not None and not self._is_behind:
            self.fault = None
            _LOG.warning("stream %s: is recorded again; %d packets are lost so far", self._stream, self.lost_packets)

    def _write_sound(self, pieces: Sequence[SoundPiece], camera: str | None) -> None:
        """Append to the sound of the open segment, of which a failure is reported once. On the recording thread."""
        if self._writer is None or self._sound_fails:
            return
        path = sound_beside(self.segments[-1].path)
        try:
            if self._sound is None:
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE_FILE))
                self._sound = PacketWriter(path, pieces[0].settings, pieces[0].packets[0].time, camera)
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
        if not self._disk.has_room:
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
        self._fail(f"recording stopped: {getattr(error, 'strerror', None) or error}")  # without the file's name

    def _fail(self, fault: str) -> None:
        """Tell why nothing is recorded now; the log has it once, however many keyframes try again."""
        if fault != self.fault:
            _LOG.error("stream %s: %s", self._stream, fault)
        self.fault = fault

    def _catch_up(self) -> None:
        """Leave out what follows up to the next keyframe, as packets were dropped. On the recording thread."""
        self._is_behind = False
        self._abandon()

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
            repaired = restored(segment.path)
        if repaired is not None:
            self.segments.append(replace(repaired, begun_ns=segment.begun_ns, begun=segment.begun))

    def retain(self) -> None:
        """Delete closed segments that are too old or too much; the newest one stays. On the recording thread."""
        retention, now = self._disk.retention, time.monotonic()
        total, old = sum(segment.kept_bytes for segment in self.segments[-1:]), []
        for segment in reversed(self.segments[:-1]):
            total += segment.kept_bytes
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
            unlink(segment.path)
        self.segments = [s for s in self.segments if s not in segments]

    def _restore(self) -> list[Segment]:
        """Segments on disk; those that were cut short by a crash are repaired."""
        segments: list[Segment] = []
        for path in sorted(self._folder.iterdir()):
            if _SEGMENT.fullmatch(path.name) and path.is_file():
                segments += filter(None, [restored(path)])
            elif not _OWN_NAMES.fullmatch(path.name):
                _LOG.warning("stream %s: %s is none of its recordings and is left alone", self._stream, path)
        return dated(segments)
