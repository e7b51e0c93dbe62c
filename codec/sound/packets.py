"""The packets of an Ogg Opus file, and files made of them, without decoding (RFC 7845)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from streamlod.codec.sound.beside import comments, look_at_sound
from streamlod.core.errors import InputError
from streamlod.core.files import put_in_place, temporary_beside

_RATE = 48_000
_HEAD = struct.Struct("<8sBBHIhB")
_MAGIC = b"OpusHead"
_SILENT_SAMPLES = 960
_SILENCE = {1: b"\xf8\xff\xfe", 2: b"\xfc\xff\xfe"}  # 20 ms without a sound (RFC 6716 section 3.1, 4.3)


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
        time: of its first sample, in samples at 48 kHz on the clock of the scenes' packets; the `pre_skip` at the
            beginning of the stream counts, too.
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
            settings = settings_of(bytes(stream.codec_context.extradata or b""))
            packets = [bytes(packet) for packet in container.demux(stream) if packet.size]
    except (av.FFmpegError, OSError, ValueError, IndexError, struct.error) as error:
        raise InputError(path, "cannot be read as Ogg Opus; copy it again") from error
    return settings, list(_timed(packets, begin))


def write_packets(path: Path, settings: OpusSettings, packets: Iterable[OpusPacket]) -> None:
    """Write packets, which follow one another in time, as a file of sound.

    Raises:
        InputError: it cannot be written.
    """
    temporary = temporary_beside(path)
    writer: PacketWriter | None = None
    try:
        for each in packets:
            writer = writer or PacketWriter(temporary, settings, each.time)
            writer.append(each)
        if writer is not None:
            writer.close()
            put_in_place(temporary, path)
    except OSError as error:
        raise InputError(path, f"cannot be written as sound ({error})") from error
    finally:
        temporary.unlink(missing_ok=True)


def sound_file(settings: OpusSettings, packets: Sequence[OpusPacket], camera: str | None = None) -> bytes:
    """The same as bytes; at least one packet. `camera`: at which the microphone stood, if at one."""
    file = BytesIO()
    writer = PacketWriter(file, settings, packets[0].time, camera)
    for each in packets:
        writer.append(each)
    writer.close()
    return file.getvalue()


class PacketWriter:
    """Writes a file of sound as it comes; what was written can be read at any time, but for the last second.

    Args:
        path: of the file; or a buffer.
        settings: of the packets.
        begin: time of the first packet, as of `OpusPacket`.
        camera: at which the microphone stood, if at one.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: Path | BinaryIO, settings: OpusSettings, begin: int, camera: str | None = None) -> None:
        import av

        self._begin, self._settings = begin, settings
        self._end = begin  # of what is written
        place = str(path) if isinstance(path, Path) else path
        with _faults_as_os_errors():
            self._container = av.open(place, "w", format="ogg", options={"fflags": "+bitexact+flush_packets"})
            self._stream = self._container.add_stream("libopus", rate=_RATE)
            self._stream.layout = "mono" if settings.channels == 1 else "stereo"
            head = _HEAD.pack(_MAGIC, 1, settings.channels, settings.pre_skip, _RATE, settings.gain, 0)
            self._stream.codec_context.extradata = head
            self._stream.metadata.update(comments(max(0, round(begin * 10**9 / _RATE)), camera))

    def append(self, packet: OpusPacket) -> None:
        """Add a packet; where some are missing before it there is silence, and one that is there already is left out.

        Raises:
            OSError: it cannot be written.
        """
        silence = _SILENCE[self._settings.channels]
        while packet.time - self._end >= _SILENT_SAMPLES:
            self._write(OpusPacket(self._end, _SILENT_SAMPLES, silence))
        if packet.time - self._end > -_SILENT_SAMPLES:
            self._write(packet)

    def close(self) -> None:
        """Finish the file.

        Raises:
            OSError: it cannot be written.
        """
        with _faults_as_os_errors():
            self._container.close()

    def _write(self, each: OpusPacket) -> None:
        import av

        packet = av.Packet(each.data)
        packet.stream, packet.time_base = self._stream, Fraction(1, _RATE)
        packet.pts = packet.dts = self._end - self._begin - self._settings.pre_skip
        packet.duration = each.samples
        self._end += each.samples
        with _faults_as_os_errors():
            self._container.mux(packet)


@contextmanager
def _faults_as_os_errors() -> Iterator[None]:
    import av

    try:
        yield
    except (av.FFmpegError, ValueError) as error:
        raise OSError(str(error)) from error


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


def settings_of(head: bytes) -> OpusSettings:
    """The settings in the head of a stream of Opus (RFC 7845 section 5.1).

    Raises:
        ValueError, struct.error: it is no such head, or of other than mono or stereo sound.
    """
    magic, _, channels, pre_skip, _, gain, family = _HEAD.unpack_from(head)
    if magic != _MAGIC or channels not in (1, 2) or family != 0:
        raise ValueError("no mono or stereo sound")
    return OpusSettings(channels, pre_skip, gain)
