"""The packets of an Ogg Opus file, and files made of them, without decoding (RFC 7845)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from streamlod.codec.sound.beside import BEGIN_COMMENT, look_at_sound
from streamlod.core.errors import InputError
from streamlod.core.files import put_in_place, temporary_beside

_RATE = 48_000
_HEAD = struct.Struct("<8sBBHIhB")
_MAGIC = b"OpusHead"


@dataclass(frozen=True, slots=True)
class OpusSettings:
    """Facts that a decoder of Opus needs.

    Attributes:
        channels: 1 or 2.
        pre_skip: samples at 48 kHz that a decoder leaves out at the beginning.
        gain: of the output, in 1/256 dB.
    """

    channels: int
    pre_skip: int
    gain: int = 0


@dataclass(frozen=True, slots=True)
class OpusPacket:
    """A packet.

    Attributes:
        time: of its first sample, in samples at 48 kHz on the clock of the packets of scenes, the `pre_skip` at the
            beginning of all counted.
        samples: that it holds, at 48 kHz.
    """

    time: int
    samples: int
    data: bytes


def read_packets(path: Path) -> tuple[OpusSettings, list[OpusPacket]]:
    """Settings and packets of a file of sound.

    Raises:
        InputError: missing, or not Ogg Opus.
    """
    import av

    begin = round(look_at_sound(path).begin_ns * _RATE / 10**9)
    try:
        with closing(av.open(str(path.absolute()), format="ogg", options={"protocol_whitelist": "file"})) as container:
            stream = container.streams.audio[0]
            settings = _settings(bytes(stream.codec_context.extradata or b""))
            packets = [bytes(packet) for packet in container.demux(stream) if packet.size]
    except (av.FFmpegError, OSError, ValueError, IndexError, struct.error) as error:
        raise InputError(path, "cannot be read as Ogg Opus; copy it again") from error
    return settings, list(_timed(packets, begin))


def write_packets(path: Path, settings: OpusSettings, packets: Iterable[OpusPacket]) -> None:
    """Write packets, which follow one another in time, as a file of sound.

    Raises:
        InputError: it cannot be written.
    """
    import av

    temporary = temporary_beside(path)
    try:
        with closing(av.open(str(temporary), "w", format="ogg", options={"fflags": "+bitexact"})) as container:
            stream = container.add_stream("libopus", rate=_RATE)
            stream.layout = "mono" if settings.channels == 1 else "stereo"
            head = _HEAD.pack(_MAGIC, 1, settings.channels, settings.pre_skip, _RATE, settings.gain, 0)
            stream.codec_context.extradata = head
            begin: int | None = None
            for each in packets:
                if begin is None:
                    begin = each.time
                    stream.metadata[BEGIN_COMMENT] = str(max(0, round(begin * 10**9 / _RATE)))
                packet = av.Packet(each.data)
                packet.stream, packet.time_base = stream, Fraction(1, _RATE)
                packet.pts = packet.dts = each.time - begin - settings.pre_skip
                packet.duration = each.samples
                container.mux(packet)
        put_in_place(temporary, path)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise InputError(path, f"cannot be written as sound ({error})") from error
    finally:
        temporary.unlink(missing_ok=True)


def samples_in(packet: bytes) -> int:
    """Samples at 48 kHz of a packet, from its first bytes (RFC 6716 section 3.1).

    Raises:
        ValueError: no packet of Opus.
    """
    if not packet:
        raise ValueError("an empty packet")
    configuration, code = packet[0] >> 3, packet[0] & 3
    if code == 3 and len(packet) < 2:
        raise ValueError("a packet without its count of frames")
    frames = (1, 2, 2, packet[1] & 63 if code == 3 else 0)[code]
    if configuration < 12:
        frame = (480, 960, 1920, 2880)[configuration & 3]
    elif configuration < 16:
        frame = (480, 960)[configuration & 1]
    else:
        frame = (120, 240, 480, 960)[configuration & 3]
    if not 0 < frames * frame <= 5760:
        raise ValueError(f"a packet of {frames} frames")
    return frames * frame


def _timed(packets: Iterable[bytes], time: int) -> Iterator[OpusPacket]:
    for data in packets:
        samples = samples_in(data)
        yield OpusPacket(time, samples, data)
        time += samples


def _settings(head: bytes) -> OpusSettings:
    magic, _, channels, pre_skip, _, gain, family = _HEAD.unpack_from(head)
    if magic != _MAGIC or channels not in (1, 2) or family != 0:
        raise ValueError("no mono or stereo sound")
    return OpusSettings(channels, pre_skip, gain)
