"""One group of pictures (GOP) on disk, and what a crash has left of it."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.container.layout import FILE_HEAD, SIZE
from streamlod.codec.packet.packet import PacketKind
from streamlod.codec.sound.beside import sound_beside
from streamlod.core.errors import BitstreamError, InputError
from streamlod.server.protocol.packets import Position

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Segment:
    """One group of pictures on disk.

    Attributes:
        path: its `.slod` file.
        first, last: positions of its keyframe and of its newest packet.
        packets, size_bytes: count and sum of sizes of its packets.
        begun_ns: Unix time of its keyframe; of a group of an earlier run as `dated` finds it, or else as the times of
            its file and packets tell.
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

    def follows(self, other: Segment) -> bool:
        """Whether it is the next one of the same run; a keyframe may have the version of the packet before it."""
        return self.first.epoch == other.first.epoch and self.first.version <= other.last.version + 1

    def begun_at(self, unix_ns: int) -> Segment:
        """The same of another time, which is known better."""
        return replace(self, begun_ns=unix_ns, begun=_monotonic(unix_ns))

    @property
    def kept_bytes(self) -> int:
        """Bytes that retention counts: of its packets, and of the file of its sound as it is now."""
        try:
            return self.size_bytes + sound_beside(self.path).stat().st_size
        except OSError:  # no sound
            return self.size_bytes


def restored(path: Path) -> Segment | None:
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
            _LOG.warning("%s holds no whole keyframe and is deleted", path)
            unlink(path)
        else:
            _LOG.warning("%s is left alone: %s", path, fault)
        return None
    if not is_whole:
        try:
            SlodWriter(path, live=True).close()
            os.utime(path, ns=(written_ns, written_ns))
        except OSError as error:  # it can be read without; the next start tries again
            _LOG.warning("%s cannot be repaired now (%s)", path, error)
    epoch = int(path.stem.split("-")[0])
    first, last = Position(epoch, entries[0].to_version), Position(epoch, entries[-1].to_version)
    size = sum(entry.size_bytes for entry in entries)
    begun_ns = max(0, written_ns - max(0, entries[-1].time_ns - entries[0].time_ns))
    return Segment(path, first, last, len(entries), size, begun_ns, _monotonic(begun_ns), True)


def dated(segments: Sequence[Segment]) -> list[Segment]:
    """Segments on disk, oldest first: one that follows another one of its run began when that ended.

    How long packets were filmed tells less, as training them may take longer; of the first one nothing else is known.
    """
    found = list(segments[:1])
    for before, segment in pairwise(segments):
        found.append(segment.begun_at(before.path.stat().st_mtime_ns) if segment.follows(before) else segment)
    return found


def unlink(path: Path) -> None:
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


def _monotonic(unix_ns: int) -> float:
    """The monotonic time of an earlier Unix time, by the clock as it is set now."""
    return time.monotonic() - max(0, time.time_ns() - unix_ns) / 1e9
