"""The sound of video and audio files, on the clock of the file's pictures, at one rate and without gaps."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.audio.stream
import av.container
import numpy as np

from streamlod.core.arrays import Bool, Int16
from streamlod.core.data.video.times import OWN_CLOCK
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
_RATES = 8_000, 384_000  # samples a second of sound that is taken
_MAX_CHANNELS = 64
_SILENCE = 8  # of 32768
_LISTENING = 8000  # samples a second with which silence is looked for
_SOUGHT, _WARM_S = {"ogg"}, 1  # containers whose sound is found by time, and seconds before it that decoders need
_TOLERANCE_S = Fraction(1, 50)  # by which a file's times may waver without a gap being meant


def sound_channels(path: Path) -> int | None:
    """2, or 1 for sound of one channel; None for a file without sound that can be decoded.

    Raises:
        InputError: the file cannot be opened, or its sound is of a rate or a number of channels that is refused.
    """
    with _opened(path) as container:
        stream = sound_of(container)
        if stream is None:
            return None
        try:
            _check(stream.rate, stream.channels)
        except InputError as error:
            raise InputError(path, f"its sound {error.fault}") from error
        return min(stream.channels, 2)


def filmed_sound(path: Path, rate: int, begin_ns: int, count: int) -> Iterator[Int16]:
    """`count` samples [N, channels] of a file's sound from `begin_ns` on, in blocks, silent where the file has none.

    Sound after damage is silent too, which is logged.

    Args:
        rate: samples a second of what is yielded.
        begin_ns: time from the file's beginning as players count it; may lie before it.

    Raises:
        InputError: the file cannot be opened, or has no sound.
    """
    channels = sound_channels(path)
    if channels is None:
        raise InputError(path, "has no sound")
    done = 0
    origin = Fraction(begin_ns, 1_000_000_000)
    placer = Placer(rate, channels, -origin)
    with _opened(path) as container:
        stream = sound_of(container)
        assert stream is not None
        timed = ((None if time is None else time - origin, frame) for time, frame in timed_sound(container, stream))
        try:
            if container.format.name in _SOUGHT and origin > _WARM_S:  # else all before is decoded, too
                container.seek(int((origin - _WARM_S) * av.time_base))
            for begin, block in (each for time, frame in timed for each in placer.put(frame, time)):
                skipped = max(done - begin, 0)
                if skipped >= len(block):
                    continue
                yield from _silence(min(begin, count) - done, channels, rate)
                done = max(done, min(begin, count))
                part = block[skipped : skipped + count - done]
                if len(part):  # an empty one is no sound to encoders
                    yield part
                done += len(part)
                if done >= count:
                    return
        except av.FFmpegError as error:
            _log.warning("%s: its sound cannot be decoded after %.1f s (%s)", path, done / rate, error.strerror)
    yield from _silence(count - done, channels, rate)


def silent_seconds(path: Path, begin_ns: int, seconds: float) -> float | None:
    """The seconds from `begin_ns` until a file's sound is first heard; None where it is not within `seconds`.

    Raises:
        InputError: see `filmed_sound`.
    """
    done = 0
    for block in filmed_sound(path, _LISTENING, begin_ns, round(seconds * _LISTENING)):
        if (heard := audible(block)).any():
            return float(done + heard.argmax()) / _LISTENING
        done += len(block)
    return None


def audible(samples: Int16) -> Bool:
    """[N] which of some samples [N, channels] are more than codecs and idle converters make of silence."""
    return np.asarray(np.abs(samples.astype(np.int32)).max(axis=1) > _SILENCE, np.bool_)


class Placer:
    """Resamples the frames of a decoder, and tells when each block of samples was recorded.

    Small wavering of the frames' times is no gap: samples follow one another until they are 20 ms off.

    Args:
        rate: samples a second of what comes out.
        channels: 1 or 2.
        begin: time of a first frame that has none, in seconds.
    """

    def __init__(self, rate: int, channels: int, begin: Fraction = Fraction(0)) -> None:
        self._rate, self._channels = rate, channels
        self._resampler: av.AudioResampler | None = None
        self._form: tuple[object, ...] = ()
        self._at = begin  # time of the next sample

    def put(self, frame: av.AudioFrame, time: Fraction | None) -> Iterator[tuple[int, Int16]]:
        """The samples [N, channels] of a frame, each block with the number of its first, counted from time 0.

        Args:
            time: of the frame's first sample, in seconds; None where it follows the one before.

        Raises:
            InputError: a rate or a number of channels that is refused.
        """
        form = frame.format.name, frame.layout.name, frame.sample_rate
        off = None if time is None else abs(time - self._at)
        if self._resampler is None or form != self._form or (off is not None and off > _TOLERANCE_S):
            _check(frame.sample_rate, frame.layout.nb_channels)
            self._resampler = av.AudioResampler("s16", "mono" if self._channels == 1 else "stereo", self._rate)
            self._form, self._at = form, self._at if time is None else time
        for part in self._resampler.resample(frame):
            block = np.asarray(part.to_ndarray(), np.int16).reshape(-1, self._channels)
            yield round(self._at * self._rate), block
            self._at += Fraction(len(block), self._rate)


def sound_of(container: av.container.InputContainer) -> av.audio.stream.AudioStream | None:
    """The first sound that can be decoded; None without."""
    known = (each for each in container.streams.audio if getattr(each, "codec_context", None) is not None)
    return next(known, None)


def timed_sound(
    container: av.container.InputContainer, stream: av.audio.stream.AudioStream
) -> Iterator[tuple[Fraction | None, av.AudioFrame]]:
    """The decoded sound of a file, with its time in seconds from the file's beginning as players count it, if known.

    Raises:
        av.FFmpegError: the file cannot be read on.
    """
    own = container.format.name in OWN_CLOCK and container.start_time is not None
    origin = Fraction(container.start_time, av.time_base) if own and container.start_time else Fraction(0)
    for frame in container.decode(stream):
        time = None if frame.pts is None or frame.time_base is None else frame.pts * frame.time_base - origin
        yield time, frame


def decoded_sound(packet: av.Packet[Any]) -> Iterator[av.AudioFrame]:
    """The sound in a packet of a live source; none where it does not decode, as silence is put in its place."""
    try:
        frames: list[Any] = packet.decode()
    except av.FFmpegError:
        return
    for frame in frames:
        assert isinstance(frame, av.AudioFrame)
        yield frame


def _silence(count: int, channels: int, rate: int) -> Iterator[Int16]:
    """`count` samples of silence, a second at a time."""
    while count > 0:
        part = min(count, rate)
        yield np.zeros((part, channels), np.int16)
        count -= part


def _check(rate: int, channels: int) -> None:
    if not _RATES[0] <= rate <= _RATES[1] or not 1 <= channels <= _MAX_CHANNELS:
        fault = f"has {rate} samples a second and {channels} channels"
        raise InputError("sound", f"{fault}; {_RATES[0]} to {_RATES[1]} and 1 to {_MAX_CHANNELS} can be used")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[av.container.InputContainer]:
    try:
        container = av.open(str(path.absolute()), options={"protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "the bytes are not those of sound or video"
        raise InputError(path, f"cannot be opened for its sound: {reason}") from error
    with contextlib.closing(container):
        yield container
