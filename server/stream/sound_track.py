"""The sound of a live stream: the newest pieces in memory, older ones beside the recording."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from streamlod.codec.mp4.sound import SoundPiece, pack_piece, read_piece
from streamlod.codec.sound.beside import look_at_sound, sound_beside
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, read_packets
from streamlod.core.errors import InputError
from streamlod.server.protocol.packets import BinaryMessage
from streamlod.server.stream.recording.recording import Recording

_MEMORY_BYTES = 4_000_000  # some five minutes; what is older is on disk, where it is recorded
_READ_PIECES = 50  # at once
_PIECE_PACKETS = 10
_MAX_NS = 3_600 * 10**9  # of one answer


@dataclass(frozen=True, eq=False)
class HeldPiece:
    """A piece, and the message that carries it to viewers, made once for all of them."""

    piece: SoundPiece

    @cached_property
    def message(self) -> BinaryMessage:
        """The message of the live websocket."""
        return BinaryMessage(pack_piece(self.piece))


class SoundTrack:
    """The retained sound of one stream.

    Args:
        recording: of the stream, or None.

    Attributes:
        camera: at which the microphone stands; None where that is not known.
        listeners: called whenever there is more; they must not raise.
    """

    def __init__(self, recording: Recording | None = None) -> None:
        self._recording = recording
        self._held: deque[HeldPiece] = deque()
        self._bytes = 0
        self._earlier = None if recording is None else _facts_of(sound_beside(s.path) for s in recording.segments)
        self.camera = None if self._earlier is None else self._earlier["camera"]
        self._recorded_ns = -(2**63)  # up to which it has been handed to the recording
        # of this stream alone: another one may have files of the same names and sizes
        self._pieces_of = lru_cache(maxsize=4)(_pieces_of)
        self.listeners: set[Callable[[], None]] = set()

    @property
    def facts(self) -> dict[str, Any] | None:
        """Facts that are told, as in docs/protocol.md, `begin_ns` of the oldest piece in memory; None without any.

        Before there is any, those of what was recorded before this server began.
        """
        if not self._held:
            return self._earlier
        oldest, begin_ns = self._held[0].piece, max(0, self._held[0].piece.begin_ns)
        return {"begin_ns": begin_ns, "channels": oldest.settings.channels, "live": True, "camera": self.camera}

    def add(self, data: bytes) -> None:
        """Take the newest piece; one that does not follow in time is left out.

        Raises:
            BitstreamError: it is none.
        """
        held = HeldPiece(read_piece(data))
        if self._held and held.piece.begin_ns < self._held[-1].piece.end_ns - 1:
            return
        self._held.append(held)
        self._bytes += len(data)
        while self._bytes > _MEMORY_BYTES:
            self._bytes -= len(self._held.popleft().message.data)
        for listener in tuple(self.listeners):
            listener()

    def record_until(self, time_ns: int) -> None:
        """Hand to the recording what was heard until `time_ns`, up to which its pictures are there."""
        new = [
            each.piece
            for each in self._held
            if each.piece.begin_ns >= self._recorded_ns and each.piece.end_ns <= time_ns
        ]
        if new and self._recording is not None:
            self._recording.append_sound(new, self.camera)
            self._recorded_ns = new[-1].end_ns - 1

    async def read(self, begin_ns: int, end_ns: int | None = None) -> list[HeldPiece]:
        """The first pieces, up to ten seconds of them, between two times, in order."""
        held = self._held
        recorded = [] if self._recording is None else self._recording.segments
        if recorded and (not held or begin_ns < held[0].piece.begin_ns):
            paths = [sound_beside(segment.path) for segment in recorded]
            until = held[0].piece.begin_ns if held else None
            found = await asyncio.to_thread(self._read_files, paths, begin_ns, until)
        else:
            found = []
        wanted = [*found, *held] if len(found) < _READ_PIECES else found
        chosen = [
            each
            for each in wanted
            if each.piece.end_ns - 1 > begin_ns and (end_ns is None or each.piece.begin_ns < end_ns)
        ]
        return chosen[:_READ_PIECES]

    def _read_files(self, paths: list[Path], begin_ns: int, until_ns: int | None) -> list[HeldPiece]:
        """Recorded pieces from `begin_ns` on, from the files of as many groups of pictures as are needed."""
        found: list[HeldPiece] = []
        for path in _from(paths, begin_ns):
            try:
                pieces = self._pieces_of(path, path.stat().st_size)
            except (OSError, InputError):  # a group without sound, deleted meanwhile, or damaged
                continue
            for piece in pieces:
                if until_ns is not None and piece.begin_ns >= until_ns:
                    return found
                if piece.end_ns - 1 > begin_ns:
                    found.append(HeldPiece(piece))
            if len(found) >= _READ_PIECES:
                return found
        return found

    async def packets(self, begin_ns: int, end_ns: int | None) -> tuple[OpusSettings, list[OpusPacket]] | None:
        """The packets between two times, an hour of them at most, of one kind of settings; None without any."""
        found: list[OpusPacket] = []
        settings: OpusSettings | None = None
        last_ns = None
        while pieces := await self.read(begin_ns, end_ns):
            begin_ns = pieces[-1].piece.end_ns - 1
            last_ns = last_ns or pieces[0].piece.begin_ns + _MAX_NS
            settings = settings or pieces[0].piece.settings
            for each in pieces:
                if each.piece.settings == settings and each.piece.end_ns < last_ns:
                    found += each.piece.packets
            if begin_ns >= last_ns - 1:
                break
        return None if settings is None or not found else (settings, found)


def _from(paths: list[Path], begin_ns: int) -> Iterator[Path]:
    """The files from the last one on that begins before `begin_ns`."""
    first = 0
    low, high = 0, len(paths)
    while low < high:
        middle = (low + high) // 2
        begin = _begin_of(paths[middle])
        if begin is not None and begin <= begin_ns:
            first, low = middle, middle + 1
        elif begin is None:
            low = middle + 1
        else:
            high = middle
    yield from paths[first:]


def _facts_of(paths: Iterable[Path]) -> dict[str, Any] | None:
    """The facts of the first of these files that is one."""
    for path in paths:
        with suppress(OSError, InputError):  # a group without sound, or damaged
            return look_at_sound(path).facts(live=True)
    return None


def _begin_of(path: Path) -> int | None:
    try:
        return look_at_sound(path).begin_ns
    except (OSError, InputError):
        return None


def _pieces_of(path: Path, size: int) -> list[SoundPiece]:
    """The pieces of a file that has `size` bytes now."""
    settings, packets = read_packets(path)
    return [
        SoundPiece(settings, tuple(packets[at : at + _PIECE_PACKETS])) for at in range(0, len(packets), _PIECE_PACKETS)
    ]
