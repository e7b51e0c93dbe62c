from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.sound.opus import write_sound
from streamlod.core.data.sources import videos
from streamlod.core.data.video.sound import filmed_sound, sound_channels
from streamlod.core.errors import InputError
from tests.clicks import clicks, onsets, write_sounding
from tests.core.data.writers import picture, write_video
from tests.work import lines

RATE = 48_000
SECOND_NS = 1_000_000_000


def heard(path: Path, begin_ns: int = 0, seconds: float = 3.0) -> list[float]:
    blocks = list(filmed_sound(path, RATE, begin_ns, round(seconds * RATE)))
    samples = np.concatenate(blocks)
    assert samples.shape == (round(seconds * RATE), sound_channels(path))
    assert max(map(len, blocks)) <= RATE  # whatever a file claims, no more is held at once
    return onsets(samples)


@pytest.mark.parametrize(
    ("name", "codec", "rate", "channels", "own_delay"),
    [
        ("phone.mp4", "aac", 48_000, 1, 0.0),
        ("camera.mov", "pcm_s16le", 44_100, 2, 0.0),
        ("browser.mkv", "libopus", 48_000, 2, 0.0),
        ("television.ts", "mp2", 44_100, 2, 0.011),  # these formats cannot say by how much their encoder delays
        ("old.avi", "libmp3lame", 44_100, 1, 0.026),
    ],
)
def test_clicks_stay_where_they_were_filmed(
    tmp_path: Path, name: str, codec: str, rate: int, channels: int, own_delay: float
) -> None:
    write_sounding(tmp_path / name, 4.0, codec, rate, channels)
    assert sound_channels(tmp_path / name) == channels
    for begin in (0.0, 0.25, -0.5):
        clicked = [own_delay + at - begin for at in (0.0, 1.0, 2.0, 3.0) if 0 <= at - begin < 2.9]
        assert heard(tmp_path / name, round(begin * SECOND_NS), 2.9) == pytest.approx(clicked, abs=2e-3)


def test_sound_that_starts_late_stops_early_or_has_a_gap_is_silent_there(tmp_path: Path) -> None:
    write_sounding(tmp_path / "late.mp4", 4.0, begin=1.5)
    assert heard(tmp_path / "late.mp4", seconds=2.5) == pytest.approx([2.0], abs=2e-3)
    write_sounding(tmp_path / "gap.mkv", 4.0, "flac", without=(1.5, 2.5))
    assert heard(tmp_path / "gap.mkv", seconds=6.0) == pytest.approx([0.0, 1.0, 3.0], abs=2e-3)


def test_what_lies_before_the_wanted_sound_of_a_stream_is_not_decoded(tmp_path: Path) -> None:
    """Of a film on a slow machine each picture asks for its own piece, late in a file of the whole evening."""
    write_sound(tmp_path / "evening.opus", [clicks(90.0)], 1, 0)
    with lines(100_000):
        assert heard(tmp_path / "evening.opus", 85_500_000_000, 1.0) == pytest.approx([0.5], abs=2e-3)


def test_a_damaged_end_is_silent_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "cut.wav"
    write_sounding(path, 4.0, "pcm_s16le", pictures=False)
    path.write_bytes(path.read_bytes()[: 2 * RATE + 1000])
    assert heard(path) == pytest.approx([0.0, 1.0], abs=2e-3)
    write_sounding(tmp_path / "whole.mkv", 4.0, "flac")
    data = bytearray((tmp_path / "whole.mkv").read_bytes())
    data[len(data) // 2 :] = bytes(len(data) - len(data) // 2)
    (tmp_path / "zeros.mkv").write_bytes(data)
    with caplog.at_level(logging.WARNING):
        assert set(np.round(heard(tmp_path / "zeros.mkv"), 2)) <= {0.0, 1.0, 2.0}


def test_a_time_far_in_the_future_costs_no_memory(tmp_path: Path) -> None:
    write_sounding(tmp_path / "far.mkv", 2.0, "flac", begin=1.0, pictures=False)
    assert heard(tmp_path / "far.mkv", begin_ns=-(2**62), seconds=5.0) == []  # a hundred years before it begins


def test_files_without_sound_are_told_apart_from_files_that_are_none(tmp_path: Path) -> None:
    write_video(tmp_path / "silent.mp4", [picture(0, n) for n in range(3)])
    assert sound_channels(tmp_path / "silent.mp4") is None
    with pytest.raises(InputError, match="has no sound"):
        list(filmed_sound(tmp_path / "silent.mp4", RATE, 0, 10))
    (tmp_path / "text.wav").write_text("no sound at all")
    with pytest.raises(InputError, match="cannot be opened for its sound"):
        sound_channels(tmp_path / "text.wav")
    with pytest.raises(InputError, match=r"missing\.wav"):
        sound_channels(tmp_path / "missing.wav")
    write_sounding(tmp_path / "slow.wav", 1.0, "pcm_s16le", rate=4000, pictures=False)
    with pytest.raises(InputError, match="4000 samples a second"):
        sound_channels(tmp_path / "slow.wav")


def test_a_camera_that_began_later_has_its_sound_later(tmp_path: Path) -> None:
    """Camera b began 0.4 s after a, so that the clip begins at its file's beginning: sound of both is the clip's."""
    files = [tmp_path / "a.mp4", tmp_path / "b.mp4"]
    for file in files:
        write_sounding(file, 4.0)
    source, _ = videos(files, [0, SECOND_NS * 2 // 5])
    films = [source.film(camera) for camera in (0, 1)]
    assert [film.path for film in films] == files
    assert films[0].begin_ns - films[1].begin_ns == SECOND_NS * 2 // 5
    assert films[1].begin_ns == pytest.approx(0, abs=SECOND_NS // 50)
    assert heard(films[0].path, films[0].begin_ns) == pytest.approx([0.6, 1.6, 2.6], abs=0.02)
    assert heard(films[1].path, films[1].begin_ns) == pytest.approx([0.0, 1.0, 2.0], abs=0.02)
