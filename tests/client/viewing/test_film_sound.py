"""Films with the sound that was heard when their pictures were filmed."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.client.commands import view
from streamlod.client.recorder import open_recorder
from streamlod.client.viewing.film_sound import add_sound
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.opus import SAMPLE_RATE, write_sound
from streamlod.core.data.video.sound import filmed_sound, sound_channels
from streamlod.core.errors import InputError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.clicks import clicks, onsets
from tests.server.conftest import make_clip, running

FPS = 10
SECOND_NS = 1_000_000_000
STEP_NS = SECOND_NS // FPS


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds of stereo that begin at 0.5 s, with clicks at 0.5, 1.5, ..."""
    path = tmp_path_factory.mktemp("sound") / "clip.slod.opus"
    write_sound(path, [clicks(8.0, channels=2)], 2, SECOND_NS // 2)
    return path


def film(path: Path, pictures: int) -> Path:
    with open_recorder(path, FPS) as recorder:
        for number in range(pictures):
            recorder.add(np.full((64, 96, 3), 5 * number % 250, np.uint8))
    return path


def heard(path: Path, seconds: float) -> list[float]:
    return onsets(np.concatenate(list(filmed_sound(path, SAMPLE_RATE, 0, round(seconds * SAMPLE_RATE)))))


def from_time(begin_ns: int, count: int) -> list[int]:
    return [begin_ns + number * STEP_NS for number in range(count)]


@pytest.mark.parametrize(
    ("filmed_ns", "clicked"),
    [
        (from_time(0, 30), [0.5, 1.5, 2.5]),
        (from_time(1_700_000_000, 30), [0.8, 1.8, 2.8]),
        ([*from_time(0, 20), *from_time(4_200_000_000, 20)], [0.5, 1.5, 2.3, 3.3]),  # the stream skipped something
        ([*from_time(6_000_000_000, 10), *from_time(0, 10)], [0.5, 1.5]),  # it began again
        ([-3_000_000_000, *from_time(0, 10)], [0.6]),  # its first picture is older than the sound
        ([*from_time(0, 10), *[None] * 20], [0.5]),  # the camera flies on around the last scene
        (from_time(7_200_000_000, 30), [0.3]),  # the sound ends first
        ([time_ns + 30_000_000 * (n % 2) for n, time_ns in enumerate(from_time(0, 30))], [0.5, 1.5, 2.5]),  # jitter
    ],
)
def test_each_picture_has_the_sound_of_its_time(
    sound: Path, tmp_path: Path, filmed_ns: Sequence[int | None], clicked: list[float]
) -> None:
    path = film(tmp_path / "film.mp4", len(filmed_ns))
    with av.open(str(path)) as container:
        before = [(p.pts, bytes(p)) for p in container.demux(container.streams.video[0]) if p.size]
    add_sound(path, sound, filmed_ns, FPS)
    seconds = len(filmed_ns) / FPS
    assert heard(path, seconds) == pytest.approx(clicked, abs=5e-3)
    with av.open(str(path)) as container:
        assert [(p.pts, bytes(p)) for p in container.demux(container.streams.video[0]) if p.size] == before
        track = container.streams.audio[0]
        assert track.codec_context.name == "aac"
        assert track.duration is not None
        assert track.time_base is not None
        assert float(track.duration * track.time_base) == pytest.approx(seconds, abs=0.05)
    assert sound_channels(path) == 2
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_stays_as_it_was_without_usable_sound(tmp_path: Path) -> None:
    path = film(tmp_path / "film.mp4", 3)
    before = path.read_bytes()
    (tmp_path / "text.opus").write_text("no sound")
    with pytest.raises(InputError, match="is not Ogg Opus"):
        add_sound(path, tmp_path / "text.opus", from_time(0, 3), FPS)
    assert path.read_bytes() == before


def recorded(tmp_path: Path, with_sound: bool) -> Path:
    """A film of the first two seconds and more of a stream, as `streamlod view` makes it."""
    clip = make_clip(tmp_path / "clip.slod", 80, counts=(5, 10, 20), frame_ns=SECOND_NS // 30)
    if with_sound:
        write_sound(sound_beside(clip.path), [clicks(2.7)], 1, 0)
    out = tmp_path / "film.mp4"
    with running(Settings(), StreamSpec(play=clip.path, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        url = f"http://127.0.0.1:{server.port}"  # the page's
        assert clip.states[0].header.fps == 30
        assert view(url, out, frames=75, from_start=True) == f"75 pictures in {out}"
    return out


@pytest.mark.long
def test_a_recorded_stream_has_its_sound(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """It is said that it is added, which takes a while of a long film."""
    out = recorded(tmp_path, with_sound=True)
    assert "adding its sound" in capfd.readouterr().err
    assert heard(out, 2.4) == pytest.approx([0.0, 1.0, 2.0], abs=0.04)


@pytest.mark.long
def test_a_stream_without_sound_makes_a_silent_film(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert sound_channels(recorded(tmp_path, with_sound=False)) is None
    assert "sound" not in caplog.text
