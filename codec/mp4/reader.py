"""Reading MP4 files with packets: ours, in fragments, and those that other programs made of them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from streamlod.codec.container.layout import SIZE, Entry, entry_of
from streamlod.codec.container.packet_file import PacketFile
from streamlod.codec.mp4.box import HEAD, LARGE, Mp4Box, boxes, child, refused, take, version_and_flags
from streamlod.codec.mp4.segment import (
    BITSTREAM_VERSION,
    SCENE_ENTRY,
    SCENE_SETTINGS,
    SOUND_ENTRY,
    SOUND_RATE,
    SOUND_SETTINGS,
)
from streamlod.codec.mp4.tables import Defaults, Run, fragment_runs, most_samples, table_run
from streamlod.codec.packet.bytes import HEADER_BYTES
from streamlod.codec.packet.info import peek
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, samples_in
from streamlod.core.errors import BitstreamError

MAX_TABLE_BYTES = 64 << 20  # of a box that is read as a whole
MAX_TRACKS = 64
_WORD = struct.Struct(">I")
_AUDIO_ENTRY = 28  # bytes of a sound's sample entry, before the boxes in it
_SCENE_ENTRY = 40
_OPUS = struct.Struct(">BBHIhB")
_SAMPLE_BYTES = {SCENE_ENTRY: (SIZE.size + HEADER_BYTES, 64 << 20), SOUND_ENTRY: (1, 1 << 16)}  # least and most


@dataclass(frozen=True, slots=True)
class _Track:
    """A track of a kind that is known here."""

    number: int
    kind: bytes
    scale: int
    settings: OpusSettings | None


def is_mp4(path: Path) -> bool:
    """Whether the file begins as MP4 files do."""
    try:
        with path.open("rb") as file:
            return file.read(HEAD.size)[4:] in (b"ftyp", b"styp")
    except OSError:
        return False


class Mp4Reader(PacketFile):
    """Reads the track of scenes, and the sound beside it.

    Attributes:
        sound: settings of the sound; None without.

    Raises:
        InputError: the file cannot be opened.
        BitstreamError: `bad_file`, it is no MP4 file, is damaged or has no track of scenes; `unsupported_version`, its
            packets are of another version.
    """

    sound: OpusSettings | None

    def sound_packets(self) -> Iterator[OpusPacket]:
        """The packets of the sound in order; none without."""
        for offset, size, time in self._heard:
            data = self._at(offset, size)
            try:
                yield OpusPacket(time, samples_in(data), data)
            except ValueError as error:
                raise refused(f"the sound holds {error}") from error

    def _look(self) -> tuple[tuple[Entry, ...], int, bool]:
        tracks, runs, torn = self._runs()
        scenes = next((track for track in tracks if track.kind == SCENE_ENTRY), None)
        if scenes is None:
            raise refused(f"{self._path.name} has no track of scenes")
        heard = next((track for track in tracks if track.settings is not None), None)
        self.sound = None if heard is None else heard.settings
        self._heard = list(_placed(runs, heard, self._size)) if heard else []
        entries: list[Entry] = []
        end = 0
        for offset, size, _ in _placed(runs, scenes, self._size):
            entries += self._records(offset, size)
            end = max(end, offset + size)
        lost = any(run.track == scenes.number and (run.offsets + run.sizes > self._size).any() for run in runs)
        return tuple(entries), end, torn or lost

    def _records(self, offset: int, size: int) -> Iterator[Entry]:
        """The packets of a sample."""
        data = self._at(offset, size)
        at = 0
        while at < size:
            length = SIZE.unpack_from(data, at)[0] if at + SIZE.size <= size else size
            at += SIZE.size
            if length > size - at:
                raise refused(f"a packet of {length} bytes lies in the last {max(0, size - at)} of a sample")
            yield entry_of(peek(data[at : at + length], self._limits), offset + at)
            at += length

    def _runs(self) -> tuple[list[_Track], list[Run], bool]:
        """Known tracks, all their samples, and whether the file ends inside a box."""
        tracks: list[_Track] = []
        runs: list[Run] = []
        defaults: dict[int, Defaults] = {}
        at, most = 0, most_samples(self._size)
        while at < self._size:
            kind, head, size = self._box_at(at)
            if size < head or (at == 0 and kind not in (b"ftyp", b"styp")):
                raise refused(f"{self._path.name} is no MP4 file")
            if at + size > self._size:
                return tracks, runs, True
            if kind in (b"moov", b"moof"):
                if size > MAX_TABLE_BYTES:
                    raise refused(f"tables of {size} bytes are more than {MAX_TABLE_BYTES}")
                body = memoryview(self._at(at + head, size - head))
                if kind == b"moov":
                    tracks, defaults, found = _movie(body, most)
                else:
                    found = list(fragment_runs(body, at, defaults, most))
                runs += found
                most -= sum(len(run.sizes) for run in found)
            at += size
        return tracks, runs, False

    def _box_at(self, at: int) -> tuple[bytes, int, int]:
        """Kind, length of the head, and size of the box that begins at byte `at` of the file."""
        head = self._at(at, HEAD.size + LARGE.size)
        if len(head) < HEAD.size:
            return b"", 0, HEAD.size  # ends inside a head
        size, kind = HEAD.unpack_from(head)
        if size == 1 and len(head) == HEAD.size + LARGE.size:
            return kind, len(head), LARGE.unpack_from(head, HEAD.size)[0]
        return kind, HEAD.size, size or self._size - at


def described_sound(moov: memoryview) -> OpusSettings | None:
    """Settings of the sound of a movie; None without.

    Raises:
        BitstreamError: `bad_file`, its boxes are damaged.
    """
    tracks, _, _ = _movie(moov, most=0)
    return next((track.settings for track in tracks if track.settings is not None), None)


def _placed(runs: list[Run], track: _Track, file_size: int) -> Iterator[tuple[int, int, int]]:
    """Offset, size and time of each sample of a track that lies in the file.

    Raises:
        BitstreamError: `bad_file`, one is too short or long, or all together are longer than the file.
    """
    least, most = _SAMPLE_BYTES[track.kind]
    rows: list[list[int]] = [[], [], []]
    total = 0
    for run in (run for run in runs if run.track == track.number and len(run.sizes)):
        for size in (int(run.sizes.min()), int(run.sizes.max())):
            if not least <= size <= most:
                raise refused(f"a sample has {size} bytes, where {least} to {most} are possible")
        inside = (run.offsets >= 0) & (run.offsets + run.sizes <= file_size)
        total += int(run.sizes[inside].sum())
        if total > file_size:
            raise refused(f"samples of {total} bytes are said to lie in {file_size}")
        for column, each in zip(rows, (run.offsets, run.sizes, run.times), strict=True):
            column.extend(each[inside].tolist())
    return zip(*rows, strict=True)


def _movie(moov: memoryview, most: int) -> tuple[list[_Track], dict[int, Defaults], list[Run]]:
    """Known tracks, defaults of their fragments, and the samples that are not in fragments, `most` at most."""
    found = list(boxes(moov))
    traks = [each.body for each in found if each.kind == b"trak"]
    if len(traks) > MAX_TRACKS:
        raise refused(f"{len(traks)} tracks are more than {MAX_TRACKS}")
    tracks, runs = [], []
    for trak in traks:  # the field lies behind two times, of 4 bytes each or of 8
        version, _, body = version_and_flags(child(trak, b"tkhd"))
        (number,), _ = take(_WORD, body[16 if version else 8 :])
        media = child(trak, b"mdia")
        version, _, body = version_and_flags(child(media, b"mdhd"))
        (scale,), _ = take(_WORD, body[16 if version == 1 else 8 :])
        table = child(media, b"minf", b"stbl")
        track = _described(number, scale, child(table, b"stsd"))
        if track is not None:
            tracks.append(track)
            runs.append(table_run(number, table, most))
            most -= len(runs[-1].sizes)
    extends = [each for each in found if each.kind == b"mvex"]
    return tracks, dict(_defaults(box) for mvex in extends for box in boxes(mvex.body) if box.kind == b"trex"), runs


def _described(number: int, scale: int, stsd: memoryview) -> _Track | None:
    """The track, by its first sample entry; None where that is of no use here."""
    entry = next(boxes(version_and_flags(stsd)[2][4:]), None)
    if entry is not None and entry.kind == SCENE_ENTRY:
        settings = version_and_flags(child(entry.body[_SCENE_ENTRY:], SCENE_SETTINGS))[2]
        if len(settings) < 1 or settings[0] != BITSTREAM_VERSION:
            known = f"only {BITSTREAM_VERSION} is known here"
            raise BitstreamError(
                "unsupported_version", f"its packets have version {bytes(settings[:1]).hex()}; {known}"
            )
        return _Track(number, entry.kind, scale, None)
    if entry is not None and entry.kind == SOUND_ENTRY and scale == SOUND_RATE:
        fields, _ = take(_OPUS, child(entry.body[_AUDIO_ENTRY:], SOUND_SETTINGS))
        _, channels, pre_skip, _, gain, family = fields
        if channels in (1, 2) and family == 0:
            return _Track(number, entry.kind, scale, OpusSettings(channels, pre_skip, gain))
    return None


def _defaults(trex: Mp4Box) -> tuple[int, Defaults]:
    (number, _, duration, size), _ = take(struct.Struct(">IIII"), version_and_flags(trex.body)[2])
    return number, Defaults(duration, size)
