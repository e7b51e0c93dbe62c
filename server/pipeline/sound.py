"""The sound of a trained recording: chosen from its cameras or a file, and written beside the bitstream."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import SAMPLE_RATE, write_sound
from streamlod.core.data import Dataset
from streamlod.core.data.dataset import Film
from streamlod.core.data.video.sound import filmed_sound, sound_channels
from streamlod.core.errors import InputError

_LOG = logging.getLogger(__name__)
AUTO, NONE = "auto", "none"


@dataclass(frozen=True, slots=True)
class FilmedSound:
    """Sound as it was recorded.

    Attributes:
        film: its file, and where in it the clip begins.
        channels: 1 or 2.
    """

    film: Film
    channels: int


def choose_sound(dataset: Dataset, choice: str) -> FilmedSound | None:
    """The sound that `choice` names; None where there shall be, or is, none.

    Args:
        choice: ``auto`` for the first camera that has sound, ``none``, a camera's name, or a file that began to record
            when the first camera did.

    Raises:
        InputError: no such camera or file, or one without sound that can be used.
    """
    recording = dataset.recording
    films = {each.name: recording.source.film(row) for row, each in enumerate(recording.cameras)}
    if choice == NONE:
        return None
    if choice == AUTO:
        return next((found for film in films.values() if (found := _usable(film)) is not None), None)
    if choice in films:
        named = films[choice]
        if named is None:
            raise InputError("--sound", f"camera {choice} has pictures and no video, so no sound; name a file")
        return _required(named)
    path = Path(choice)
    if not path.is_file():
        raise InputError("--sound", f"{choice!r:.80} is neither a camera nor a file; cameras are {', '.join(films)}")
    first = next(iter(films.values()))
    return _required(Film(path, 0 if first is None else first.begin_ns))


def write_beside(out: Path, sound: FilmedSound | None, seconds: float) -> None:
    """Write the first `seconds` of the clip's sound beside the bitstream `out`; without sound, remove an earlier one's.

    Raises:
        InputError: it cannot be written.
    """
    path = sound_beside(out)
    if sound is None:
        path.unlink(missing_ok=True)
        return
    blocks = filmed_sound(sound.film.path, SAMPLE_RATE, sound.film.begin_ns, round(seconds * SAMPLE_RATE))
    write_sound(path, blocks, sound.channels, begin_ns=0)


def _usable(film: Film | None) -> FilmedSound | None:
    try:
        channels = None if film is None else sound_channels(film.path)
    except InputError as error:
        _LOG.warning("%s; its sound is left out", error)
        return None
    return None if film is None or channels is None else FilmedSound(film, channels)


def _required(film: Film) -> FilmedSound:
    channels = sound_channels(film.path)
    if channels is None:
        raise InputError(film.path, "has no sound; choose another camera, a file, or --sound none")
    return FilmedSound(film, channels)
