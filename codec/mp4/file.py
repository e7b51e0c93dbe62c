"""Whole MP4 files out of `.slod` files, and their parts for HLS. FORMAT.md section 19."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from streamlod.codec.container.join import FilePart, Piece
from streamlod.codec.container.layout import SIZE, Entry
from streamlod.codec.container.reader import SlodReader
from streamlod.codec.container.writer import SlodWriter
from streamlod.codec.mp4.playlist import Playlist, PlaylistPart, playlist_text
from streamlod.codec.mp4.reader import Mp4Reader
from streamlod.codec.mp4.samples import TIMESCALE, samples_of
from streamlod.codec.mp4.segment import SOUND_RATE, beginning, fragment_head
from streamlod.codec.packet.packet import PacketKind
from streamlod.codec.sound.beside import find_sound, sound_beside
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, read_packets, write_packets
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.files import write_bytes, write_text, written_whole

INDEX, BEGINNING = "index.m3u8", "init.mp4"  # of a folder or address with HLS


@dataclass(frozen=True, slots=True)
class Group:
    """A group of pictures of a file, as a segment.

    Attributes:
        time, end: when it begins, and ends, in microseconds on the clock of the packets' times.
        entries: its packets.
        sound: what is to be heard meanwhile.
    """

    time: int
    end: int
    entries: tuple[Entry, ...]
    sound: tuple[OpusPacket, ...] = ()

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return (self.end - self.time) / TIMESCALE

    def pieces(self, path: Path) -> tuple[Piece, ...]:
        """The bytes of the segment; packets stay in the file that holds them."""
        samples = samples_of(self.entries, self.end)
        first, last = self.entries[0], self.entries[-1]
        begin, end = first.offset - SIZE.size, last.offset + last.size_bytes
        head = fragment_head(first.to_version + 1, samples, self.sound)
        return head, FilePart(path, begin, end - begin), b"".join(packet.data for packet in self.sound)


def groups_of(entries: Sequence[Entry], sound: Sequence[OpusPacket] = (), end: int | None = None) -> tuple[Group, ...]:
    """The groups of pictures of a file whose packets lie one after the other, with the sound that belongs to them.

    Args:
        end: when the last one ends, in microseconds; by default as long after its last sample as that is after the one
            before.

    Raises:
        BitstreamError: `bad_file`, it does not begin with a keyframe, or something lies between packets.
    """
    _check_order(entries)
    begins = [
        n
        for n, e in enumerate(entries)
        if e.kind is PacketKind.KEY and (n == 0 or e.keyframe != entries[n - 1].keyframe)
    ]
    samples = samples_of(entries, end)
    time_of = {sample.first: sample.time for sample in samples}
    times = [*(time_of[begin] for begin in begins), samples[-1].time + samples[-1].duration]
    borders = [-(2**63), *(time * SOUND_RATE // TIMESCALE for time in times[1:-1]), 2**63]
    return tuple(
        Group(
            times[n],
            times[n + 1],
            tuple(entries[first:behind]),
            tuple(packet for packet in sound if borders[n] <= packet.time < borders[n + 1]),
        )
        for n, (first, behind) in enumerate(pairwise([*begins, len(entries)]))
    )


def sound_of(slod: Path) -> tuple[OpusSettings | None, list[OpusPacket]]:
    """Settings and packets of the sound that lies beside a `.slod` file; None and nothing without."""
    found = find_sound(slod)
    return (None, []) if found is None else read_packets(found.path)


def write_mp4(slod: Path, out: Path) -> tuple[int, bool]:
    """Write the packets of a `.slod` file, and the sound beside it, as an MP4 file of one fragment a group of pictures.

    Returns the number of groups, and whether there is sound.

    Raises:
        InputError: the file cannot be read, holds no keyframe, or the other one cannot be written.
        BitstreamError: it is damaged.
    """
    settings, groups = _opened(slod)
    try:
        with written_whole(out) as temporary, temporary.open("wb") as file:
            file.write(beginning(settings))
            for group in groups:
                for piece in group.pieces(slod):
                    file.write(_bytes_of(piece))
    except (OSError, ValueError) as error:
        raise InputError(out, f"cannot be written ({error})") from error
    return len(groups), settings is not None


def write_hls(slod: Path, folder: Path) -> tuple[int, bool]:
    """Write the packets of a `.slod` file, and the sound beside it, as a folder that any web server offers as HLS.

    Returns the number of segments, and whether there is sound.

    Raises:
        InputError: the file cannot be read, holds no keyframe, or the folder cannot be written.
        BitstreamError: it is damaged.
    """
    settings, groups = _opened(slod)
    names = [f"{number:06d}.m4s" for number in range(len(groups))]
    parts = tuple(PlaylistPart(name, group.seconds) for name, group in zip(names, groups, strict=True))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / BEGINNING, beginning(settings))
        for name, group in zip(names, groups, strict=True):
            write_bytes(folder / name, b"".join(map(_bytes_of, group.pieces(slod))))
        write_text(folder / INDEX, playlist_text(Playlist(BEGINNING, parts, is_complete=True)))
    except (OSError, ValueError) as error:
        raise InputError(folder, f"cannot be written ({error})") from error
    return len(groups), settings is not None


def write_slod(mp4: Path, out: Path) -> tuple[int, bool]:
    """Write the packets of an MP4 file, byte for byte, as a `.slod` file, and its sound beside that.

    Returns the number of packets, and whether there is sound.

    Raises:
        InputError: it is cut short, damaged or holds no packets, or the other one cannot be written.
    """
    try:
        with Mp4Reader(mp4) as reader, SlodWriter(out) as slod:
            if not reader.is_whole or not reader.entries:
                raise InputError(mp4, "is cut short, or holds no packets; copy or record it again")
            for packet in reader.packets():
                slod.append(packet)
            sound = list(reader.sound_packets())
            if reader.sound is not None and sound:
                write_packets(sound_beside(out), reader.sound, sound)
            return len(reader.entries), bool(sound)
    except BitstreamError as error:
        raise InputError(mp4, f"is damaged: {error}") from error


def _opened(slod: Path) -> tuple[OpusSettings | None, tuple[Group, ...]]:
    """The groups of pictures of a whole file with their sound, and the settings of that."""
    with SlodReader(slod) as reader:
        if not reader.is_whole:
            raise InputError(slod, "is cut short; copy or record it again")
        settings, packets = sound_of(slod)
        return settings, groups_of(reader.entries, packets)


def _bytes_of(piece: Piece) -> bytes:
    if isinstance(piece, bytes):
        return piece
    with piece.path.open("rb") as file:
        file.seek(piece.offset)
        return file.read(piece.size)


def _check_order(entries: Sequence[Entry]) -> None:
    if not entries or entries[0].kind is not PacketKind.KEY:
        raise BitstreamError("bad_file", "the file does not begin with a keyframe")
    for before, entry in pairwise(entries):
        if entry.offset != before.offset + before.size_bytes + SIZE.size:
            raise BitstreamError("bad_file", "something lies between the packets of the file")
