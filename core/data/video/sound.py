"""The sound of video and audio files, on the clock of the file's pictures, at one rate and without gaps."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import av.audio.stream
import av.container
import numpy as np

from streamlod.core.arrays import Int16
from streamlod.core.data.video.times import OWN_CLOCK
from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
_RATES = 8_000, 384_000  # samples a second of sound that is taken
_MAX_CHANNELS = 64
_TOLERANCE_S = Fraction(1, 50)  # by which a file's times may waver without a gap being meant


def sound_channels(path: Path) -> int | None:
    """2, or 1 for sound of one channel; None for a file without sound that can be decoded.

    Raises:
        InputError: the file cannot be opened, or its sound is of a rate or a number of channels that is refused.
    """
    with _opened(path) as container:
        stream = _stream_of(container)
        if stream is None:
            return None
        if not _RATES[0] <= stream.rate <= _RATES[1] or not 1 <= stream.channels <= _MAX_CHANNELS:
            fault = f"its sound has {stream.rate} samples a second and {stream.channels} channels"
            raise InputError(path, f"{fault}; {_RATES[0]} to {_RATES[1]} and 1 to {_MAX_CHANNELS} can be used")
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
    with _opened(path) as container:
        try:
            for begin, block in _placed(container, rate, channels, begin_ns):
                skipped = max(done - begin, 0)
                if skipped >= len(block):
                    continue
                yield from _silence(min(begin, count) - done, channels, rate)
                done = max(done, min(begin, count))
                part = block[skipped : skipped + count - done]
                yield part
                done += len(part)
                if done >= count:
                    return
        except av.FFmpegError as error:
            _log.warning("%s: its sound cannot be decoded after %.1f s (%s)", path, done / rate, error.strerror)
    yield from _silence(count - done, channels, rate)


def _placed(
    container: av.container.InputContainer, rate: int, channels: int, begin_ns: int
) -> Iterator[tuple[int, Int16]]:
    """Blocks with the number of their first sample from `begin_ns` on; a file's small wavering of times is no gap."""
    stream = _stream_of(container)
    assert stream is not None
    origin = Fraction(begin_ns, 1_000_000_000)
    if container.format.name in OWN_CLOCK and container.start_time is not None:
        origin += Fraction(container.start_time, av.time_base)
    layout = "mono" if channels == 1 else "stereo"
    resampler = av.AudioResampler("s16", layout=layout, rate=rate)
    at: Fraction | None = None  # time of the next sample, from the beginning that is wanted
    for frame in container.decode(stream):
        if frame.pts is not None and frame.time_base is not None:
            time = frame.pts * frame.time_base - origin
            if at is None or abs(time - at) > _TOLERANCE_S:
                resampler, at = av.AudioResampler("s16", layout=layout, rate=rate), time
        at = -origin if at is None else at
        for part in resampler.resample(frame):
            block = np.asarray(part.to_ndarray(), np.int16).reshape(-1, channels)
            yield round(at * rate), block
            at += Fraction(len(block), rate)


def _silence(count: int, channels: int, rate: int) -> Iterator[Int16]:
    """`count` samples of silence, a second at a time."""
    while count > 0:
        part = min(count, rate)
        yield np.zeros((part, channels), np.int16)
        count -= part


def _stream_of(container: av.container.InputContainer) -> av.audio.stream.AudioStream | None:
    """The first sound that can be decoded."""
    known = (each for each in container.streams.audio if getattr(each, "codec_context", None) is not None)
    return next(known, None)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[av.container.InputContainer]:
    try:
        container = av.open(str(path.absolute()), options={"protocol_whitelist": "file"})
    except (av.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "the bytes are not those of sound or video"
        raise InputError(path, f"cannot be opened for its sound: {reason}") from error
    with contextlib.closing(container):
        yield container
