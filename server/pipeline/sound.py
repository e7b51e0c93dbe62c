"""The sound of a trained recording: chosen from its cameras or a file, and written beside the bitstream."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.codec.sound.beside import RECORDED, look_at_sound, sound_beside
from streamlod.codec.sound.opus import SAMPLE_RATE, write_sound
from streamlod.core.arrays import Float64
from streamlod.core.calibration.sound.alike import RATE, rises
from streamlod.core.data import Dataset
from streamlod.core.data.dataset import Film
from streamlod.core.data.video.sound import filmed_sound, silent_seconds, sound_channels
from streamlod.core.errors import InputError

_LOG = logging.getLogger(__name__)
AUTO, NONE = "auto", "none"
_LATE_S = 1.5
_LISTENED_S = 120.0


@dataclass(frozen=True, slots=True)
class FilmedSound:
    """Sound as it was recorded.

    Attributes:
        film: its file, and where in it the clip begins.
        channels: 1 or 2.
        camera: whose video it is; None for a file of its own.
    """

    film: Film
    channels: int
    camera: str | None


def choose_sound(dataset: Dataset, choice: str) -> FilmedSound | None:
    """The sound that `choice` names; None where there shall be, or is, none.

    Args:
        choice: ``auto`` for the sound that was recorded with the rig, else the first camera that is heard; ``none``, a
            camera's name, or a file that began to record when the first camera did, or says when it did. A sentence in
            the log names a microphone that is silent or heard late.

    Raises:
        InputError: no such camera or file, or one without sound that can be used.
    """
    recording = dataset.recording
    films = {each.name: recording.source.film(row) for row, each in enumerate(recording.cameras)}
    if choice == NONE:
        return None
    seconds = _seconds(dataset)
    if choice == AUTO:
        recorded = _recorded(recording.path / RECORDED, films)
        if recorded is not None and _listened(RECORDED, recorded.film, seconds):
            return recorded
        for name, film in films.items():
            if film is not None and (found := _usable(name, film)) is not None and _listened(name, film, seconds):
                return found
        return None
    named = films.get(choice)
    if choice in films:
        if named is None:
            raise InputError("--sound", f"camera {choice} has pictures and no video, so no sound; name a file")
    elif not Path(choice).is_file():
        raise InputError("--sound", f"{choice!r:.80} is neither a camera nor a file; cameras are {', '.join(films)}")
    sound = _apart(Path(choice), films) if named is None else _required(named, choice)
    _listened(choice, sound.film, seconds)
    return sound


def sound_faults(dataset: Dataset) -> list[str]:
    """A sentence for each camera whose microphone is silent over the whole recording, or heard late only."""
    seconds = _seconds(dataset)
    begins = {name: silent_seconds(film.path, film.begin_ns, seconds) for name, film in _sounding(dataset).items()}
    return [fault for name, begin in begins.items() if (fault := _fault(name, begin))]


def loudness_rises(dataset: Dataset) -> dict[str, Float64]:
    """How the loudness rises in each camera that has sound, within two minutes, on the clock that pairs pictures."""
    count = round(min(_seconds(dataset), _LISTENED_S) * RATE)
    return {
        name: rises(np.concatenate(list(filmed_sound(film.path, RATE, film.begin_ns, count))))
        for name, film in _sounding(dataset).items()
    }


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
    write_sound(path, blocks, sound.channels, begin_ns=0, camera=sound.camera)


def _sounding(dataset: Dataset) -> dict[str, Film]:
    """Films of cameras with sound that can be used."""
    recording = dataset.recording
    films = {camera.name: recording.source.film(row) for row, camera in enumerate(recording.cameras)}
    return {name: film for name, film in films.items() if film is not None and _usable(name, film) is not None}


def _usable(name: str, film: Film) -> FilmedSound | None:
    try:
        channels = sound_channels(film.path)
    except InputError as error:
        _LOG.warning("%s; its sound is left out", error)
        return None
    return None if channels is None else FilmedSound(film, channels, name)


def _seconds(dataset: Dataset) -> float:
    return dataset.recording.source.time_ns(dataset.frame_count - 1) / 1e9 + 1 / dataset.recording.source.fps


def _listened(name: str, film: Film, seconds: float) -> bool:
    """Whether a film is heard at all; what is wrong with its sound is logged."""
    begin = silent_seconds(film.path, film.begin_ns, seconds)
    if fault := _fault(name, begin):
        _LOG.warning("%s", fault)
    return begin is not None


def _fault(name: str, begin: float | None) -> str:
    """A sentence about sound that is first heard after `begin` seconds, None: never; empty if nothing is wrong."""
    if begin is None:
        return f"no sound of {name}: it recorded silence; was it muted, or had it no power?"
    if begin > _LATE_S:
        return f"the sound of {name} starts {begin:.1f} s after its pictures; until then there is silence"
    return ""


def _recorded(path: Path, films: Mapping[str, Film | None]) -> FilmedSound | None:
    """The sound of a file that may be there, as of `_apart`; None without, or if it cannot be used, which is logged."""
    try:
        return _apart(path, films) if path.is_file() else None
    except InputError as error:
        _LOG.warning("%s; it is left out", error)
        return None


def _apart(path: Path, films: Mapping[str, Film | None]) -> FilmedSound:
    """The sound of a file of its own; one of `RECORDED` says when it began, and at which camera it was heard."""
    begin_ns, camera = 0, None
    with suppress(InputError):  # sound of another kind, which says nothing of that
        found = look_at_sound(path)
        begin_ns, camera = found.begin_ns, found.camera if found.camera in films else None
    beside = films[camera] if camera is not None else next(iter(films.values()))
    return _required(Film(path, (0 if beside is None else beside.begin_ns) - begin_ns), camera)


def _required(film: Film, camera: str | None) -> FilmedSound:
    channels = sound_channels(film.path)
    if channels is None:
        raise InputError(film.path, "has no sound; choose another camera, a file, or --sound none")
    return FilmedSound(film, channels, camera)
