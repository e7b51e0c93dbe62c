"""Live sound in pieces of a few packets, each a whole MP4 file of one fragment, as browsers' media sources take it.

Whoever gets one needs nothing that came before. docs/sound.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from streamlod.codec.mp4.box import boxes, child, refused, take, version_and_flags
from streamlod.codec.mp4.reader import described_sound
from streamlod.codec.mp4.segment import SOUND_RATE, beginning, fragment_head
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, samples_in
from streamlod.core.errors import BitstreamError

MAX_PIECE_BYTES = 1 << 16
_SECOND_NS = 1_000_000_000
_RUN_HEAD, _RUN_ROW = struct.Struct(">Ii"), struct.Struct(">III")
_TIME = struct.Struct(">Q")
_MAX_TIME = 2**62


@dataclass(frozen=True, slots=True)
class SoundPiece:
    """Packets of sound that follow one another.

    Attributes:
        settings: of the packets.
        packets: at least one.
    """

    settings: OpusSettings
    packets: tuple[OpusPacket, ...]

    @property
    def begin_ns(self) -> int:
        """Time at which its first packet begins, on the clock of the scenes' packets."""
        return (self.packets[0].time - self.settings.pre_skip) * _SECOND_NS // SOUND_RATE

    @property
    def end_ns(self) -> int:
        """Time at which its last packet ends."""
        last = self.packets[-1]
        return (last.time + last.samples - self.settings.pre_skip) * _SECOND_NS // SOUND_RATE


def is_piece(message: bytes) -> bool:
    """Whether a binary message of the live websocket is sound: packets of scenes begin otherwise."""
    return message[4:8] == b"ftyp"


def pack_piece(piece: SoundPiece) -> bytes:
    """The bytes of a piece; `read_piece` goes back."""
    head = beginning(piece.settings, scenes=False) + fragment_head(1, (), piece.packets)
    return head + b"".join(packet.data for packet in piece.packets)


def read_piece(data: bytes) -> SoundPiece:
    """The piece that `pack_piece` made; nothing else is taken, so that what is passed on is known in every byte.

    Raises:
        BitstreamError: `bad_file`, it is anything else.
    """
    if len(data) > MAX_PIECE_BYTES:
        raise refused(f"a piece of sound of {len(data)} bytes is longer than {MAX_PIECE_BYTES}")
    found = {each.kind: each.body for each in boxes(memoryview(data))}
    settings = described_sound(found.get(b"moov", memoryview(b"")))
    if settings is None:
        raise refused("it is no piece of sound")
    part = child(found.get(b"moof", memoryview(b"")), b"traf")
    (time,), _ = take(_TIME, version_and_flags(child(part, b"tfdt"))[2])
    (count, _), rows = take(_RUN_HEAD, version_and_flags(child(part, b"trun"))[2])
    samples = found.get(b"mdat", memoryview(b""))
    if not 0 < count * _RUN_ROW.size <= len(rows) or time > _MAX_TIME:
        raise refused("its table of packets is damaged")
    packets, at = [], 0
    for number in range(count):
        size = _RUN_ROW.unpack_from(rows, number * _RUN_ROW.size)[1]
        packet = bytes(samples[at : at + size])
        try:
            packets.append(OpusPacket(time, samples_in(packet), packet))
        except ValueError as error:
            raise refused(f"it holds {error}") from error
        time, at = time + packets[-1].samples, at + size
    piece = SoundPiece(settings, tuple(packets))
    if pack_piece(piece) != data:
        raise BitstreamError("bad_file", "its boxes are not those of a piece of sound")
    return piece
