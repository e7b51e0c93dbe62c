"""Ogg Opus files (RFC 7845), written from samples."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from fractions import Fraction
from pathlib import Path

import av
import av.audio.stream
import numpy as np

from streamlod.codec.sound.beside import comments
from streamlod.core.arrays import Int16
from streamlod.core.errors import InputError
from streamlod.core.files import written_whole

SAMPLE_RATE = 48_000  # the only rate at which Opus counts (RFC 7845, section 4)
BITS_A_SECOND = {1: 64_000, 2: 96_000}
LAYOUTS = {1: "mono", 2: "stereo"}


def write_sound(path: Path, blocks: Iterable[Int16], channels: int, begin_ns: int, camera: str | None = None) -> None:
    """Write a whole file of sound, which appears when it is complete.

    Args:
        blocks: samples [N, channels] at 48 kHz, in order.
        channels: 1 or 2.
        begin_ns: time of the first sample, on the clock of the packets' times.
        camera: at which the microphone stood, if at one.

    Raises:
        InputError: it cannot be written; what was there before stays.
    """
    try:
        with (
            written_whole(path) as temporary,
            closing(av.open(str(temporary), "w", format="ogg", options={"fflags": "+bitexact"})) as container,
        ):
            stream = container.add_stream("libopus", rate=SAMPLE_RATE)
            stream.layout, stream.format = LAYOUTS[channels], "s16"
            stream.bit_rate = BITS_A_SECOND[channels]
            stream.options = {"frame_duration": "20"}
            stream.metadata.update(comments(begin_ns, camera))
            at = 0
            for block in blocks:
                container.mux(stream.encode(audio_frame(block, at)))
                at += len(block)
            container.mux(stream.encode(None))
    except (av.FFmpegError, OSError) as error:
        raise InputError(path, f"cannot be written ({error.strerror})") from error


def audio_frame(block: Int16, at: int) -> av.AudioFrame:
    """A block [N, channels] for an encoder; its first sample has the number `at`, at 48 kHz."""
    samples = np.ascontiguousarray(block).reshape(1, -1)
    frame = av.AudioFrame.from_ndarray(samples, format="s16", layout=LAYOUTS[block.shape[1]])
    frame.sample_rate, frame.pts, frame.time_base = SAMPLE_RATE, at, Fraction(1, SAMPLE_RATE)
    return frame
