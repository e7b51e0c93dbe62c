"""Sound with a click at each whole second, written as cameras write it, and where clicks are heard in samples."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from streamlod.codec.sound.beside import look_at_sound
from tests.opus import read_sound

_CLICK_SECONDS = 0.01
_LOUD = 0.2  # of full scale
_APART_SECONDS = 0.1  # less is one click


def clicks(seconds: float, rate: int = 48_000, channels: int = 1, begin: float = 0.0) -> NDArray[np.int16]:
    """[N, channels] samples from `begin` on: 10 ms of 2 kHz at each whole second, silence between."""
    time = begin + np.arange(round(seconds * rate)) / rate
    heard = (time >= 0) & (time % 1.0 < _CLICK_SECONDS)
    wave = np.where(heard, 0.8 * np.sin(2 * np.pi * 2000 * (time % 1.0)), 0.0)
    return np.repeat((wave * 32767).astype(np.int16)[:, None], channels, axis=1)


def onsets(samples: NDArray[np.int16], rate: int = 48_000) -> list[float]:
    """Seconds at which clicks begin in [N, channels] samples."""
    loud = np.flatnonzero(np.abs(samples.astype(np.float64)).max(axis=1) > _LOUD * 32767) / rate
    return [float(now) for i, now in enumerate(loud) if i == 0 or now - loud[i - 1] > _APART_SECONDS]


def heard_at(sound: Path) -> list[float]:
    """When clicks begin in an Ogg Opus file, on its clock in seconds."""
    samples = np.concatenate(list(read_sound(sound)))
    return [look_at_sound(sound).begin_ns / 1e9 + at for at in onsets(samples)]


def write_sounding(
    path: Path,
    seconds: float,
    codec: str = "aac",
    rate: int = 48_000,
    channels: int = 1,
    begin: float = 0.0,
    late: float = 0.0,
    without: tuple[float, float] = (0.0, 0.0),
    pictures: Sequence[NDArray[np.uint8]] | bool = True,
    fps: int = 25,
    sound: NDArray[np.int16] | None = None,
) -> None:
    """A file whose picture flashes white and whose sound clicks at each whole second of its own time.

    Args:
        pictures: [H,W,3] RGB, to be seen in place of the flashing ones, `fps` a second; False for none.
        begin: when its sound begins. late: how much later than flashes its clicks are.
        sound: [N, channels] samples to be heard in place of clicks.
        without: from when to when there is no sound at all, as if packets had been lost.
    """
    layout: Any = "mono" if channels == 1 else "stereo"
    with av.open(str(path), "w") as container:
        if pictures is True:
            pictures = [np.full((64, 96, 3), 20 if at % fps else 255, np.uint8) for at in range(round(seconds * fps))]
        video = container.add_stream("libx264", rate=fps, options={"tune": "zerolatency"}) if pictures else None
        audio = container.add_stream(codec, rate=rate)
        audio.layout = layout
        if video is not None and pictures:
            video.height, video.width = pictures[0].shape[:2]
            video.pix_fmt = "yuv420p"
            for number, image in enumerate(pictures):
                picture = av.VideoFrame.from_ndarray(image)
                picture.pts = number
                container.mux(video.encode(picture))
            container.mux(video.encode(None))
        samples = clicks(seconds - begin, rate, channels, begin - late) if sound is None else sound
        size = audio.frame_size or 1024
        for at in range(0, len(samples), size):
            if without[0] <= begin + at / rate < without[1]:
                continue
            frame = av.AudioFrame.from_ndarray(samples[at : at + size].reshape(1, -1), "s16", layout)
            frame.sample_rate, frame.time_base = rate, Fraction(1, rate)
            frame.pts = round(begin * rate) + at
            container.mux(audio.encode(frame))
        container.mux(audio.encode(None))
