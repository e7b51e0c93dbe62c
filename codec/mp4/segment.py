"""The beginning of an MP4 file and its fragments. ISO/IEC 14496-12:2022, section 8.8, FORMAT.md section 19.

A fragment needs nothing but the beginning, which is the same for all streams without sound, and for all with equal
settings of Opus. So one behind the other they are a file, and each alone is a segment of HLS.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from streamlod.codec.mp4.box import HEAD, box, full_box
from streamlod.codec.mp4.samples import TIMESCALE, Sample
from streamlod.codec.sound.packets import OpusPacket, OpusSettings

SCENES, SOUND = 1, 2  # numbers of the tracks
SCENE_ENTRY, SCENE_SETTINGS = b"slp1", b"slpC"
SOUND_ENTRY, SOUND_SETTINGS = b"Opus", b"dOps"
SOUND_RATE = 48_000
BITSTREAM_VERSION = 1
_VOLUMETRIC, _AUDIBLE = b"volv", b"soun"
_BRANDS = b"iso6", b"mp41"
_IDENTITY = struct.pack(">9i", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)  # the matrix of a picture, unused here
_UNDETERMINED = 0x55C4  # the language `und`
_SYNC, _NOT_SYNC = 0x0200_0000, 0x0101_0000
_MOOF_BASE, _RUN_FIELDS = 0x020000, 0x000701  # offset of the data; duration, size and flags of each sample
_MOST_BYTES = 2**31 - 1  # of a fragment, as offsets are 32 bits with a sign


def beginning(sound: OpusSettings | None = None, *, scenes: bool = True) -> bytes:
    """The initialisation segment: which tracks there are."""
    tracks = []
    if scenes:
        tracks.append((SCENES, _trak(SCENES, _VOLUMETRIC, TIMESCALE, full_box(b"vvhd", 0, 0), _scene_entry())))
    if sound is not None:
        track = _trak(SOUND, _AUDIBLE, SOUND_RATE, full_box(b"smhd", 0, 0, bytes(4)), _sound_entry(sound), sound)
        tracks.append((SOUND, track))
    movie = struct.pack(">IIIIiH10x", 0, 0, TIMESCALE, 0, 0x10000, 0x100 if sound else 0)
    movie += _IDENTITY + bytes(24) + struct.pack(">I", tracks[-1][0] + 1)
    extends = [full_box(b"trex", 0, 0, struct.pack(">5I", number, 1, 0, 0, 0)) for number, _ in tracks]
    return box(b"ftyp", _BRANDS[0], bytes(4), *_BRANDS) + box(
        b"moov", full_box(b"mvhd", 0, 0, movie), *(track for _, track in tracks), box(b"mvex", *extends)
    )


def fragment_head(number: int, samples: Sequence[Sample], sound: Sequence[OpusPacket] = ()) -> bytes:
    """All of a fragment up to its data: that of the samples, as it lies in a `.slod` file, then that of the sound.

    Args:
        number: from 1, ascending within a file.

    Raises:
        ValueError: more than 2 GiB.
    """
    seen = [(s.duration, s.size_bytes, _SYNC if s.is_sync else _NOT_SYNC) for s in samples]
    heard = [(p.samples, len(p.data), _SYNC) for p in sound]
    size = sum(row[1] for row in seen)
    runs = [(SCENES, samples[0].time, seen, 0)] if samples else []
    runs += [(SOUND, sound[0].time, heard, size)] if sound else []
    size += sum(row[1] for row in heard)
    length = len(_moof(number, runs, 0))
    if length + HEAD.size + size > _MOST_BYTES:
        raise ValueError(f"{size} bytes are more than a fragment holds")
    return _moof(number, runs, length + HEAD.size) + HEAD.pack(HEAD.size + size, b"mdat")


def _moof(number: int, runs: Sequence[tuple[int, int, Sequence[tuple[int, int, int]], int]], data_at: int) -> bytes:
    parts = [full_box(b"mfhd", 0, 0, struct.pack(">I", number))]
    for track, time, rows, offset in runs:
        head = struct.pack(">Ii", len(rows), data_at + offset)
        parts.append(
            box(
                b"traf",
                full_box(b"tfhd", 0, _MOOF_BASE, struct.pack(">I", track)),
                full_box(b"tfdt", 1, 0, struct.pack(">Q", time)),
                full_box(b"trun", 0, _RUN_FIELDS, head, *(struct.pack(">3I", *row) for row in rows)),
            )
        )
    return box(b"moof", *parts)


def _trak(
    number: int, handler: bytes, scale: int, header: bytes, entry: bytes, sound: OpusSettings | None = None
) -> bytes:
    """A track without samples of its own; sound is cut by the samples with which its decoder begins."""
    visible = struct.pack(">IIIIIQhhhH", 0, 0, number, 0, 0, 0, 0, 0, 0x100 if sound else 0, 0) + _IDENTITY + bytes(8)
    cut = b""
    if sound is not None:
        cut = box(b"edts", full_box(b"elst", 0, 0, struct.pack(">IIihh", 1, 0, sound.pre_skip, 1, 0)))
    source = box(b"dinf", full_box(b"dref", 0, 0, struct.pack(">I", 1), full_box(b"url ", 0, 1)))
    tables = [full_box(kind, 0, 0, bytes(4)) for kind in (b"stts", b"stsc")]
    tables += [full_box(b"stsz", 0, 0, bytes(8)), full_box(b"stco", 0, 0, bytes(4))]
    described = full_box(b"stsd", 0, 0, struct.pack(">I", 1), entry)
    media = box(
        b"mdia",
        full_box(b"mdhd", 0, 0, struct.pack(">IIIIHH", 0, 0, scale, 0, _UNDETERMINED, 0)),
        full_box(b"hdlr", 0, 0, bytes(4), handler, bytes(12), b"streamlod\0"),
        box(b"minf", header, source, box(b"stbl", described, *tables)),
    )
    return box(b"trak", full_box(b"tkhd", 0, 3, visible), cut, media)


def _scene_entry() -> bytes:
    """A VolumetricVisualSampleEntry (ISO/IEC 14496-12:2022, section 12.10.3)."""
    settings = full_box(SCENE_SETTINGS, 0, 0, bytes([BITSTREAM_VERSION, 0, 0, 0]))
    return box(SCENE_ENTRY, bytes(6), struct.pack(">H", 1), b"\x09streamlod".ljust(32, b"\0"), settings)


def _sound_entry(sound: OpusSettings) -> bytes:
    """An OpusSampleEntry with its OpusSpecificBox (Opus in ISO Base Media File Format, 2018, section 4.3)."""
    settings = struct.pack(">BBHIhB", 0, sound.channels, sound.pre_skip, SOUND_RATE, sound.gain, 0)
    audio = struct.pack(">6xH8xHHHHI", 1, sound.channels, 16, 0, 0, SOUND_RATE << 16)
    return box(SOUND_ENTRY, audio, box(SOUND_SETTINGS, settings))
