"""Packets in MP4 files: byte for byte there and back, with sound in step, read by other programs, and hostile files."""

from __future__ import annotations

import contextlib
import json
import random
import struct
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from streamlod.client.recording import decode_frames, decode_version
from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.mp4 import Mp4Reader, write_hls, write_mp4, write_slod
from streamlod.codec.mp4.box import box, boxes, child, full_box
from streamlod.codec.mp4.reader import MAX_TABLE_BYTES
from streamlod.codec.mp4.samples import samples_of
from streamlod.codec.mp4.segment import beginning
from streamlod.codec.packet.levels import split_levels
from streamlod.codec.sound.beside import look_at_sound, sound_beside
from streamlod.codec.sound.opus import write_sound
from streamlod.codec.sound.packets import read_packets, samples_in
from streamlod.core.arrays import Int16
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.scene.residual import difference
from tests.clicks import clicks, onsets
from tests.codec.scenes import make_scene, move
from tests.opus import read_sound
from tests.server.conftest import make_clip
from tests.work import memory

KEY_EVERY, FRAMES, FRAME_NS = 10, 30, 33_333_333
BEGIN_NS = 40_000_000


@pytest.fixture(scope="module")
def slod(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of a second in three groups of pictures, with sound that begins at 40 ms."""
    path = make_clip(tmp_path_factory.mktemp("mp4") / "clip.slod", FRAMES, (4, 8), KEY_EVERY, FRAME_NS).path
    write_sound(sound_beside(path), [clicks(3.0, channels=2)[: 48_000 * 2]], 2, BEGIN_NS)
    return path


@pytest.fixture(scope="module")
def mp4(slod: Path) -> Path:
    path = slod.with_name("clip.mp4")
    assert write_mp4(slod, path) == (FRAMES // KEY_EVERY, True)
    return path


def packets_of(path: Path) -> list[bytes]:
    with SlodReader(path) as reader:
        return list(reader.packets())


def test_packets_and_sound_come_back_byte_for_byte(slod: Path, mp4: Path, tmp_path: Path) -> None:
    assert write_slod(mp4, tmp_path / "back.slod") == (FRAMES, True)
    assert (tmp_path / "back.slod").read_bytes() == slod.read_bytes()
    before, after = sound_beside(slod), sound_beside(tmp_path / "back.slod")
    assert read_packets(after) == read_packets(before)
    assert abs(look_at_sound(after).begin_ns - BEGIN_NS) < 1e9 / 48_000
    heard = [onsets(samples_heard(path)) for path in (before, after)]
    assert heard[0] == heard[1]
    assert heard[0]


def samples_heard(path: Path) -> Int16:
    return np.concatenate(list(read_sound(path)))


def test_states_are_decoded_from_the_file_itself(slod: Path, mp4: Path) -> None:
    assert [f.time_ns for f in decode_frames(mp4)] == [f.time_ns for f in decode_frames(slod)]
    for version in (0, 9, 17, FRAMES - 1):
        assert decode_version(mp4, version).version == decode_version(slod, version).version == version


def test_ffprobe_lists_both_tracks_at_their_times(slod: Path, mp4: Path) -> None:
    shown = "stream=codec_type,codec_name,codec_tag_string,time_base:packet=stream_index,pts_time,size"
    command = ["ffprobe", "-v", "error", "-show_entries", shown, "-of", "json", mp4]
    told = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    scenes, sound = told["streams"]
    assert (scenes["codec_type"], scenes["codec_tag_string"], scenes["time_base"]) == ("data", "slp1", "1/1000000")
    assert (sound["codec_type"], sound["codec_name"]) == ("audio", "opus")
    times = [float(each["pts_time"]) for each in told["packets"] if each["stream_index"] == 0]
    sizes = [int(each["size"]) for each in told["packets"] if each["stream_index"] == 0]
    assert times == pytest.approx([frame * FRAME_NS / 1e9 for frame in range(FRAMES)], abs=2e-6)
    assert sizes == [len(packet) + 4 for packet in packets_of(slod)]
    heard = [float(each["pts_time"]) for each in told["packets"] if each["stream_index"] == 1]
    assert heard[0] == pytest.approx(BEGIN_NS / 1e9 - 312 / 48_000, abs=1e-4)  # a decoder leaves out 312
    assert all(after - before == pytest.approx(0.02, abs=1e-3) for before, after in pairwise(heard))


def test_ffmpeg_takes_out_the_records_as_they_are(slod: Path, mp4: Path, tmp_path: Path) -> None:
    out = tmp_path / "records"
    subprocess.run(["ffmpeg", "-v", "error", "-i", mp4, "-map", "0:0", "-c", "copy", "-f", "data", out], check=True)
    assert out.read_bytes() == b"".join(struct.pack("<I", len(packet)) + packet for packet in packets_of(slod))


def test_keyframes_alone_are_sync_samples(slod: Path, mp4: Path) -> None:
    with SlodReader(slod) as reader:
        samples = samples_of(reader.entries)
    assert [n for n, sample in enumerate(samples) if sample.is_sync] == [0, 10, 20]
    flags = []
    for fragment in (each.body for each in boxes(memoryview(mp4.read_bytes())) if each.kind == b"moof"):
        run = bytes(child(fragment, b"traf", b"trun"))
        rows = struct.iter_unpack(">III", run[12:])
        flags += [word for _, _, word in rows]
    assert [n for n, word in enumerate(flags) if not word & 0x10000] == [0, 10, 20]


def test_packets_of_one_instant_are_one_sample_and_packets_to_seek_with_stay(tmp_path: Path) -> None:
    """A keyframe in two parts, previews at one time, a packet over several versions, a clock that went back."""
    path, times, key = tmp_path / "odd.slod", (5000, 5000, 7000, 7000, 1000), make_scene((4, 8))
    with SlodWriter(path) as writer:
        for packet in split_levels(encode_keyframe(key, time_ns=5000, profile=0)):
            writer.append(packet)
        state = key
        for number, time in enumerate(times[2:]):
            after = move(state, seed=number)
            writer.append(encode_residual(state, difference(state, after), time_ns=time, profile=0))
            state = after
        writer.append(encode_residual(key, difference(key, state), time_ns=7000, profile=0))
        writer.append(encode_keyframe(as_keyframe(make_scene((3, 3)), 9), time_ns=2000, profile=0))
    write_mp4(path, tmp_path / "odd.mp4")
    write_slod(tmp_path / "odd.mp4", tmp_path / "back.slod")
    assert packets_of(tmp_path / "back.slod") == packets_of(path)
    with SlodReader(path) as reader:
        samples = samples_of(reader.entries)
    assert all(after.time > before.time for before, after in pairwise(samples))
    assert [sample.count for sample in samples] == [2, 4, 1]
    assert [sample.is_sync for sample in samples] == [True, False, True]


def test_a_cut_file_keeps_what_is_whole_and_is_not_taken_for_whole(slod: Path, mp4: Path, tmp_path: Path) -> None:
    data, whole = mp4.read_bytes(), packets_of(slod)
    ends = _ends(data)
    for length in range(0, len(data), 397):
        path = tmp_path / "cut.mp4"
        path.write_bytes(data[:length])
        with contextlib.suppress(BitstreamError), Mp4Reader(path) as reader:
            found = list(reader.packets())
            assert found == whole[: len(found)]
            assert not reader.is_whole or length in ends
        if length not in ends:
            with pytest.raises(InputError, match=r"cut|damaged"):
                write_slod(path, tmp_path / "none.slod")
            assert not (tmp_path / "none.slod").exists()


def _ends(data: bytes) -> set[int]:
    ends, at = set(), 0
    for each in boxes(memoryview(data)):
        at += len(each.body) + 8
        ends.add(at)
    return ends


def test_damaged_tables_are_refused_or_name_no_more_than_there_is(mp4: Path, tmp_path: Path) -> None:
    data, chance = mp4.read_bytes(), random.Random(3)
    tables = [n for n in range(len(data)) if n < 1400 or data.find(b"moof", n, n + 900) >= 0]
    path = tmp_path / "damaged.mp4"
    for _ in range(200):
        broken = bytearray(data)
        for place in chance.sample(tables, chance.choice((1, 1, 2, 4))):
            broken[place] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))
        path.write_bytes(broken)
        with contextlib.suppress(BitstreamError), Mp4Reader(path) as reader:  # nothing else comes out
            assert sum(len(packet.data) for packet in reader.sound_packets()) <= len(data)
            assert sum(map(len, reader.packets())) <= len(data)


def _with_run(columns: int, count: int, body: bytes, default_size: int = 0, runs: int = 1) -> bytes:
    """The beginning of a file of ours and one fragment with `runs` runs that say this."""
    track = full_box(b"tfhd", 0, 0x020010, struct.pack(">II", 1, default_size))
    run = full_box(b"trun", 0, columns, struct.pack(">I", count), body)
    traf = box(b"traf", track, full_box(b"tfdt", 1, 0, bytes(8)), run * runs)
    return beginning() + box(b"moof", traf) + box(b"mdat", bytes(64))


@pytest.mark.parametrize(
    ("columns", "count", "body", "default_size", "fault"),
    [
        (0x200, 2**31, b"", 0, "samples are more than"),
        (0, 2**22, b"", 1, "samples are more than"),
        (0, 5, b"", 1, "a sample has 1 bytes"),
        (0, 5, b"", 2**31, "a sample has"),
        (0, 5, b"", 0, "a sample has 0 bytes"),
        (0x700, 1000, bytes(100), 0, "has 100 bytes behind it"),
        (0x201, 1, struct.pack(">iI", -(2**31), 8), 0, "a sample has 8 bytes"),
        (0x200, 1, struct.pack(">I", 2**32 - 1), 0, "a sample has"),
    ],
)
def test_runs_that_lie_take_no_memory(
    tmp_path: Path, columns: int, count: int, body: bytes, default_size: int, fault: str
) -> None:
    path = tmp_path / "lying.mp4"
    path.write_bytes(_with_run(columns, count, body, default_size))
    with memory() as taken, pytest.raises(BitstreamError, match=fault) as caught, Mp4Reader(path):
        pass
    assert caught.value.code == "bad_file"
    assert taken.peak_bytes < 1 << 20


def test_many_runs_that_each_name_what_may_be_take_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "lying.mp4"
    path.write_bytes(_with_run(0, 2**16, b"", 100, runs=500))
    with memory() as taken, pytest.raises(BitstreamError, match="samples are more than"), Mp4Reader(path):
        pass
    assert taken.peak_bytes < 8 << 20


def test_boxes_that_lie_are_refused(mp4: Path, tmp_path: Path) -> None:
    data = mp4.read_bytes()
    moov = data.index(b"moov") - 4
    (length,) = struct.unpack_from(">I", data, moov)
    deep = b""
    for _ in range(2000):
        deep = box(b"trak", deep)
    again = full_box(b"trun", 0, 0x201, struct.pack(">IiI", 1, 0, 500))
    track = full_box(b"tfhd", 0, 0x020000, struct.pack(">I", 1)) + full_box(b"tfdt", 0, 0, bytes(4))
    cases = {
        "are said to lie in": beginning() + box(b"moof", box(b"traf", track, again * 90)),
        "no MP4 file": b"SLOD" + bytes(60),
        "no track of scenes": data[: data.index(b"moov") - 4] + box(b"free", bytes(100)),
        "does not fit": data[:moov] + struct.pack(">I", length - 8) + data[moov + 4 :],
        "there is no box tkhd": data[:moov] + box(b"moov", deep),
        "tracks are more than": data[:moov] + box(b"moov", box(b"trak") * 100),
        "tables of": data[:moov] + struct.pack(">I4sQ", 1, b"moov", MAX_TABLE_BYTES + 17) + bytes(MAX_TABLE_BYTES + 1),
        "only 1 is known": data.replace(b"slpC\0\0\0\0\x01", b"slpC\0\0\0\0\x02"),
    }
    for fault, broken in cases.items():
        path = tmp_path / "broken.mp4"
        path.write_bytes(broken)
        with pytest.raises(BitstreamError, match=fault), Mp4Reader(path):
            pass


def test_a_folder_of_hls_is_what_ffprobe_takes_for_one(slod: Path, tmp_path: Path) -> None:
    assert write_hls(slod, tmp_path / "hls") == (3, True)
    shown = ["-show_entries", "stream=codec_tag_string,nb_read_packets", "-count_packets", "-of", "json"]
    command = ["ffprobe", "-v", "error", "-allowed_extensions", "ALL", *shown, tmp_path / "hls" / "index.m3u8"]
    told = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    counts = {each["codec_tag_string"]: int(each["nb_read_packets"]) for each in told["streams"]}
    assert counts == {"slp1": FRAMES, "Opus": len(read_packets(sound_beside(slod))[1])}


def test_lengths_of_opus_packets_follow_from_their_first_bytes() -> None:
    cases = [(b"\xfc", 960), (b"\x78\0", 960), (b"\x18\0", 2880), (b"\x80", 120), (b"\x81", 240), (b"\xff\x03", 2880)]
    assert [samples_in(packet) for packet, _ in cases] == [samples for _, samples in cases]
    for broken in (b"", b"\xff", b"\xff\x00", b"\xff\x3f"):
        with pytest.raises(ValueError, match="packet"):
            samples_in(broken)
