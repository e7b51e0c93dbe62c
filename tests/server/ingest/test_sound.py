"""The sound of live rigs: on the clock of their pictures, without gaps, and never in the way of pictures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.packets import write_packets
from streamlod.core.errors import InputError
from streamlod.server.ingest.live import LiveDataset, open_live
from tests.clicks import heard_at, write_sounding
from tests.core.data.writers import write_video
from tests.server.ingest.rig import NEEDS_FFMPEG, sending, write_definition
from tests.server.ports import free_ports

FLASH = 128  # brightness of a picture that is one
IN_STEP = 0.04  # seconds


def _film(rig: Path, count: int) -> tuple[list[int], list[float], LiveDataset]:
    """Times [ns] of flashes, and of clicks [s], in the first `count` instants of a rig."""
    pieces: list[SoundPiece] = []
    dataset = open_live(rig, give_sound=pieces.append)
    seen = [(frame.time_ns, frame.images[0].mean()) for frame in dataset.frames(0, count)]
    flashes = [time for (time, bright), (_, before) in zip(seen[1:], seen, strict=False) if bright > FLASH > before]
    return flashes, _clicks(pieces, rig.with_name("heard.opus")), dataset


def _clicks(pieces: Sequence[SoundPiece], to: Path) -> list[float]:
    """When clicks begin, seconds since 1970; the pieces follow one another."""
    if not pieces:
        return []
    for before, after in itertools.pairwise(pieces):
        assert abs(after.begin_ns - before.end_ns) < 2
    write_packets(to, pieces[0].settings, [packet for piece in pieces for packet in piece.packets])
    return heard_at(to)


def _in_step(flashes: Sequence[int], clicks: Sequence[float]) -> bool:
    """Whether every flash has its click; all but the last, which may be on its way."""
    return all(min(abs(click - flash / 1e9) for click in clicks) < IN_STEP for flash in flashes[:-1])


def _rig(folder: Path, sources: list[str], sound: str | None, **fields: object) -> Path:
    return write_definition(folder, sources, size=(96, 64), fps=25, **({"sound": sound} if sound else {}), **fields)


@pytest.mark.parametrize("name", ["a.mp4", "a.ts", "a.mkv"])
def test_clicks_of_a_file_are_heard_with_its_flashes(tmp_path: Path, name: str) -> None:
    write_sounding(tmp_path / name, 4)
    write_sounding(tmp_path / "b.mp4", 4)
    flashes, clicks, dataset = _film(_rig(tmp_path, [name, "b.mp4"], "cam0", realtime=False), 90)
    assert dataset.definition.microphone == "cam0"
    assert len(flashes) == 3
    assert _in_step(flashes, clicks)


def test_sound_of_another_file_begins_with_the_pictures(tmp_path: Path) -> None:
    write_sounding(tmp_path / "a.mp4", 4)
    write_sounding(tmp_path / "recorder.wav", 4, codec="pcm_s16le", channels=2, pictures=False)
    flashes, clicks, dataset = _film(_rig(tmp_path, ["a.mp4"], "recorder.wav", realtime=False), 90)
    assert dataset.definition.microphone is None
    assert len(flashes) == 3
    assert _in_step(flashes, clicks)


def test_a_rig_that_asks_for_no_sound_has_none(tmp_path: Path) -> None:
    write_sounding(tmp_path / "a.mp4", 2)
    flashes, clicks, _ = _film(_rig(tmp_path, ["a.mp4"], None, realtime=False), 40)
    assert flashes
    assert not clicks


def test_sound_that_starts_late_is_on_time(tmp_path: Path) -> None:
    write_sounding(tmp_path / "a.mp4", 4, begin=1.5)
    flashes, clicks, _ = _film(_rig(tmp_path, ["a.mp4"], "cam0", realtime=False), 90)
    assert len(flashes) == 3
    assert _in_step(flashes[1:], clicks)
    assert min(abs(click - flashes[0] / 1e9) for click in clicks) > 0.5


@pytest.mark.long
@NEEDS_FFMPEG
def test_sound_of_a_camera_comes_on_the_clock_of_its_pictures(tmp_path: Path) -> None:
    write_sounding(tmp_path / "clip.ts", 9)
    (port,) = free_ports(1)
    rig = _rig(tmp_path, [f"tcp+listen://127.0.0.1:{port}"], "cam0")
    with sending(tmp_path / "clip.ts", ("-f", "mpegts", f"tcp://127.0.0.1:{port}"), again=True):
        flashes, clicks, _ = _film(rig, 140)  # of 225; a busy machine leaves out pictures, and so flashes
    assert len(flashes) > 2
    assert _in_step(flashes[1:], clicks), (flashes, clicks)


@pytest.mark.long
def test_pictures_go_on_without_the_sound(tmp_path: Path) -> None:
    """A camera without sound, and a microphone that is not there: a sentence each."""
    write_sounding(tmp_path / "a.mp4", 3)
    for source, fault in {"cam1": "holds no sound", "alsa:///hw:31": "no sound of alsa:///hw:31: "}.items():
        rig = _rig(tmp_path, ["a.mp4", _mute(tmp_path)], source)
        dataset, told = open_live(rig, give_sound=lambda _: None), []
        for _ in dataset.frames(0, 30):
            statistics = dataset.statistics()
            assert statistics is not None
            told.append(statistics.sound)
        assert fault in str(told[-1])


def _mute(folder: Path) -> str:
    write_video(folder / "mute.mp4", [np.zeros((64, 96, 3), np.uint8)] * 75, 25)
    return "mute.mp4"


@pytest.mark.parametrize(
    ("sound", "fault"),
    [
        ("cam7", "neither a camera"),
        ("push:", "gives none by itself"),
        ("alsa:///file:x,raw", "names no microphone"),
        ("alsa:///hw:1,0", "realtime can be false only"),
        ("gopher://a/b", "unknown scheme"),
    ],
)
def test_sound_that_cannot_be_is_refused(tmp_path: Path, sound: str, fault: str) -> None:
    write_sounding(tmp_path / "a.mp4", 1)
    with pytest.raises(InputError, match=fault):
        open_live(_rig(tmp_path, ["a.mp4"], sound, realtime=False))
