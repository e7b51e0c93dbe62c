"""Ogg Opus files as samples."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import cast

import av

from streamlod.codec.sound.opus import SAMPLE_RATE
from streamlod.core.arrays import Int16

PACKET_SAMPLES = 960  # 20 ms


def read_sound(path: Path) -> Iterator[Int16]:
    """Blocks [N, channels] of a file's samples at 48 kHz, decoded as they are asked for."""
    with closing(av.open(str(path.absolute()), format="ogg")) as container:
        resampler = av.AudioResampler("s16", rate=SAMPLE_RATE)
        for frame in container.decode(container.streams.audio[0]):
            for part in resampler.resample(frame):
                yield cast(Int16, part.to_ndarray()).reshape(-1, part.layout.nb_channels)
