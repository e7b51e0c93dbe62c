from __future__ import annotations

import os
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.codec.sound.beside import MAX_CAMERA_NAME, find_sound, look_at_sound, sound_beside
from streamlod.codec.sound.encoder import SoundEncoder
from streamlod.codec.sound.opus import SAMPLE_RATE, write_sound
from streamlod.codec.sound.packets import sound_file
from streamlod.core.errors import InputError
from tests.clicks import clicks, onsets
from tests.opus import PACKET_SAMPLES, read_sound


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """2.01 s of stereo that begin at 1.5 s."""
    samples = clicks(2.01, channels=2)
    write_sound(tmp_path / "clip.slod.opus", iter([samples[:50_000], samples[50_000:]]), 2, 1_500_000_000)
    return tmp_path / "clip.slod.opus"


def test_sound_survives_its_file(file: Path) -> None:
    found = look_at_sound(file)
    assert (found.begin_ns, found.channels, found.size_bytes) == (1_500_000_000, 2, file.stat().st_size)
    samples = np.concatenate(list(read_sound(file)))
    assert samples.shape == (round(2.01 * SAMPLE_RATE), 2)  # neither the encoder's delay nor what fills its last packet
    assert onsets(samples) == pytest.approx([0.0, 1.0, 2.0], abs=1e-3)


@pytest.mark.parametrize("name", ["cam02", 'Kamera "3" \\ Tür', "x" * MAX_CAMERA_NAME])
def test_a_file_names_the_camera_of_its_microphone(tmp_path: Path, name: str) -> None:
    path = tmp_path / "clip.slod.opus"
    write_sound(path, [clicks(0.1)], 1, 20, name)
    found = look_at_sound(path)
    assert (found.begin_ns, found.camera) == (20, name)
    encoder = SoundEncoder(1)
    write = sound_file(encoder.settings, encoder.put(clicks(0.1), 0), name)
    path.write_bytes(write)
    assert look_at_sound(path).camera == name


@pytest.mark.parametrize("text", [b'"cam0\x002"', b'"cam\\02"', b'"cam02 ', b"cam0002", b'"\\u0007"'])
def test_a_damaged_name_of_a_camera_is_none(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "clip.slod.opus"
    write_sound(path, [clicks(0.1)], 1, 20, "cam002"[: len(text) - 2])
    data = path.read_bytes()
    at = data.index(b"STREAMLOD_CAMERA=") + len(b"STREAMLOD_CAMERA=")
    path.write_bytes(data[:at] + text + data[at + len(text) :])
    found = look_at_sound(path)
    assert (found.begin_ns, found.camera) == (20, None)


def test_any_reader_of_ogg_finds_opus_packets_of_20_ms_and_the_begin(file: Path) -> None:
    with av.open(str(file)) as container:
        stream = container.streams.audio[0]
        assert (container.format.name, stream.codec_context.name) == ("ogg", "opus")
        assert stream.metadata["STREAMLOD_BEGIN_NS"] == "1500000000"
        packets = [packet for packet in container.demux(stream) if packet.size]
        assert {packet.duration for packet in packets[:-1]} == {PACKET_SAMPLES}
        assert (packets[1].pts or 0) - (packets[0].pts or 0) == PACKET_SAMPLES


def test_mono_stays_mono(tmp_path: Path) -> None:
    write_sound(tmp_path / "mono.opus", [clicks(1.5)], 1, 0)
    assert look_at_sound(tmp_path / "mono.opus").channels == 1
    assert np.concatenate(list(read_sound(tmp_path / "mono.opus"))).shape == (72_000, 1)


def test_a_failure_leaves_what_was_there(file: Path) -> None:
    before = file.read_bytes()

    def failing() -> object:
        yield clicks(0.1, channels=2)
        raise RuntimeError("the source broke")

    with pytest.raises(RuntimeError):
        write_sound(file, failing(), 2, 0)  # type: ignore[arg-type]
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


def test_what_is_no_opus_is_refused(file: Path) -> None:
    data = file.read_bytes()
    for name, wrong in {
        "empty": b"",
        "text": b"<html>" * 100,
        "cut": data[:36],
        "many-channels": data.replace(b"OpusHead\x01\x02", b"OpusHead\x01\xff"),
        "no-opus": data.replace(b"OpusHead", b"vorbis\0\0"),
    }.items():
        path = file.with_name(name)
        path.write_bytes(wrong)
        with pytest.raises(InputError, match=name):
            look_at_sound(path)
    write_sound(file, [clicks(0.1)], 1, 2**63)
    with pytest.raises(InputError, match="which no clock shows"):
        look_at_sound(file)
    with pytest.raises(InputError, match="is no file"):
        look_at_sound(file.parent)


def test_only_a_plain_file_beside_the_bitstream_is_its_sound(file: Path, tmp_path: Path) -> None:
    assert find_sound(tmp_path / "clip.slod") == look_at_sound(file)
    assert find_sound(tmp_path / "other.slod") is None
    (tmp_path / "away").mkdir()
    sound_beside(tmp_path / "away" / "clip.slod").symlink_to(file)
    assert find_sound(tmp_path / "away" / "clip.slod") is None
    os.mkfifo(sound_beside(tmp_path / "pipe.slod"))
    assert find_sound(tmp_path / "pipe.slod") is None  # at once: nobody waits for who writes into it
