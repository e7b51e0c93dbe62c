"""`.slod` files frame by frame, whole and cut."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from streamlod.client.inspection import describe_file
from streamlod.client.recording import decode_frames, decode_version, open_recording, versions
from streamlod.codec.container import SlodWriter
from streamlod.codec.container.layout import FILE_HEAD, entry_of, file_end, record
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.levels import split_levels
from streamlod.core.errors import InputError
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.scene.metadata import Metadata
from streamlod.core.scene.residual import difference
from tests.client.clips import FRAME_NS, packets, plain_scene, states, write_clip
from tests.codec.scenes import assert_same_state
from tests.vectors.make import FOLDER, level_hash, read_stream
from tests.work import bytes_read


def test_frames_are_the_encoders_states(tmp_path: Path) -> None:
    scenes = states(5)
    data = write_clip(tmp_path / "a.slod", scenes)
    frames = list(decode_frames(tmp_path / "a.slod"))
    assert len(frames) == 5
    for scene, frame in zip(scenes, frames, strict=True):
        assert_same_state(scene, frame.scene)
        assert frame.time_ns == scene.version * FRAME_NS
    assert [frame.key_bytes for frame in frames] == [len(data[0]), 0, 0, 0, 0]
    assert [frame.predicted_bytes for frame in frames] == [0, *map(len, data[1:])]
    assert_same_state(scenes[3], decode_version(tmp_path / "a.slod", 3))
    assert versions(tmp_path / "a.slod") == (0, 1, 2, 3, 4)


def test_a_recording_is_opened_by_a_path_that_is_text(tmp_path: Path) -> None:
    scenes = states(2)
    write_clip(tmp_path / "a.slod", scenes)
    recording = open_recording(str(tmp_path / "a.slod"))
    assert_same_state(scenes[1], recording.scene(1))
    assert len(list(recording.frames())) == 2


def test_an_early_keyframe_is_replaced_and_a_new_one_counted_apart(tmp_path: Path) -> None:
    early = plain_scene(seed=3)
    first = replace(plain_scene(), keyframe=1, version=1)
    second = replace(states(2)[1], keyframe=1, version=2)
    fresh = as_keyframe(second, 2)
    parts = [
        encode_keyframe(early, time_ns=0, profile=0),
        *split_levels(encode_keyframe(first, time_ns=0, profile=0)),
        encode_residual(first, difference(first, second), time_ns=FRAME_NS, profile=0),
        encode_keyframe(fresh, time_ns=FRAME_NS, profile=0),
    ]
    with SlodWriter(tmp_path / "a.slod") as writer:
        for part in parts:
            writer.append(part)
    frames = list(decode_frames(tmp_path / "a.slod"))
    assert [frame.scene.version for frame in frames] == [1, 2]
    assert frames[0].key_bytes == sum(map(len, parts[1:-2]))
    assert (frames[1].predicted_bytes, frames[1].key_bytes) == (len(parts[-2]), len(parts[-1]))
    assert_same_state(fresh, frames[1].scene)


VALID: list[dict[str, Any]] = json.loads((FOLDER / "manifest.json").read_text())["valid"]


@pytest.mark.parametrize("vector", VALID, ids=lambda v: v["name"])
def test_streams_cut_into_levels_end_in_the_state_of_the_format(tmp_path: Path, vector: dict[str, Any]) -> None:
    """FORMAT.md section 15: in order, without packets refused as version_mismatch."""
    parts = [part for packet in read_stream(FOLDER / vector["file"]) for part in split_levels(packet)]
    with SlodWriter(tmp_path / "a.slod") as writer:
        for part in parts:
            writer.append(part)
    *_, last = decode_frames(tmp_path / "a.slod")
    assert [level_hash(level) for level in last.scene.levels] == vector["states"][-1]["levels"]


def test_levels_that_come_later_belong_to_the_instant_in_which_they_come(tmp_path: Path) -> None:
    scenes = states(3)
    parts = [split_levels(packet) for packet in packets(scenes)]
    with SlodWriter(tmp_path / "a.slod") as writer:
        for level in range(len(scenes[0].levels)):
            for part in parts:
                writer.append(part[level])
    frames = list(decode_frames(tmp_path / "a.slod"))
    assert [frame.time_ns for frame in frames] == [0, FRAME_NS, 2 * FRAME_NS]
    assert_same_state(scenes[2], frames[2].scene)
    assert_same_state(scenes[1], decode_version(tmp_path / "a.slod", 1))


def test_an_index_of_overlapping_packets_costs_no_more_than_the_file(tmp_path: Path) -> None:
    """20 000 entries of one megabyte each, all over the same bytes: read one by one, they would be 20 GB."""
    data = packets(states(1))[0] + bytes(1 << 20)
    entry = entry_of(peek(packets(states(1))[0]), 12)
    records = FILE_HEAD + record(data)
    path = tmp_path / "a.slod"
    path.write_bytes(records + file_end([replace(entry, size_bytes=1 << 20)] * 20_000, len(records)))
    before = bytes_read()
    with pytest.raises(InputError, match="holds no whole keyframe"):
        describe_file(path)
    assert bytes_read() - before < 100 << 20


def test_skips_that_help_to_seek_are_no_frames(tmp_path: Path) -> None:
    scenes = states(4)
    skip = encode_residual(scenes[0], difference(scenes[0], scenes[3]), time_ns=3 * FRAME_NS, profile=0)
    with SlodWriter(tmp_path / "a.slod") as writer:
        for packet in [*packets(scenes), skip]:
            writer.append(packet)
    frames = list(decode_frames(tmp_path / "a.slod"))
    assert [frame.scene.version for frame in frames] == [0, 1, 2, 3]
    assert_same_state(scenes[3], frames[3].scene)


def test_a_file_cut_at_any_byte_is_refused_by_name(tmp_path: Path) -> None:
    whole = tmp_path / "whole.slod"
    write_clip(whole, states(3, plain_scene((3, 5))))
    data, path = whole.read_bytes(), tmp_path / "cut.slod"
    inside = range(100, len(data) - 400, 37)
    for size in [*range(100), *inside, *range(len(data) - 400, len(data))]:
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=re.escape(str(path))):
            list(decode_frames(path))
    with pytest.raises(InputError, match=re.escape(str(path))):
        decode_version(path, 1)


def test_the_description_of_a_torn_file_says_what_is_whole_and_what_is_lost(tmp_path: Path) -> None:
    whole, path = tmp_path / "whole.slod", tmp_path / "torn.slod"
    packets = write_clip(whole, states(3, plain_scene((3, 5))))
    data = whole.read_bytes()
    ends = [8 + sum(4 + len(packet) for packet in packets[: n + 1]) for n in range(3)]

    def described(damaged: bytes) -> str:
        path.write_bytes(damaged)
        return describe_file(path)

    assert "cut short" not in described(data)
    assert f"1 packets, to byte {ends[0]}, are there; 20 bytes of an incomplete" in described(data[: ends[0] + 20])
    text = described(data[: ends[1]])
    assert f"2 packets, to byte {ends[1]}, are there; only the index is missing" in text
    assert "frames 0 to 1," in text
    assert "3 packets" in described(data[:-1])
    flipped = bytearray(data)
    flipped[ends[1] - 3] ^= 1
    assert "damaged: 1 of 3 packets (1);" in described(bytes(flipped))
    for size in (0, 7, 8, 30, ends[0] - 1):
        with pytest.raises(InputError, match=re.escape(str(path))):
            described(data[:size])


def test_description_adds_up(tmp_path: Path) -> None:
    path, scenes = tmp_path / "a.slod", states(4)
    data = write_clip(path, scenes)
    text = describe_file(path)
    assert f"{scenes[0].anchor_count} anchors of 4 Gaussians" in text
    assert "cam00 480x270, cam01 480x270" in text
    coarsest = int(scenes[0].levels[0].alive.sum())
    share = coarsest / scenes[0].anchor_count
    assert re.search(rf"^ +0 +{coarsest} +{share:.0%}$", text, re.MULTILINE)
    assert re.search(rf"^ +{len(scenes[0].levels) - 1} +\d+ +100%$", text, re.MULTILINE)
    assert re.search(rf"^key +1 +{len(data[0]) / 1000:.1f} ", text, re.MULTILINE)
    assert re.search(rf"^change +3 +{sum(map(len, data[1:])) / 1000:.1f} ", text, re.MULTILINE)
    by_level, by_chunk = (int(n) for n in (_total(text, "bytes by level"), _total(text, "bytes by chunk")))
    assert 0 < by_level < by_chunk < sum(map(len, data))


def test_description_says_what_the_file_says_of_its_scene(tmp_path: Path) -> None:
    facts = Metadata(0.5, (0.0, -1.0, 0.0), 1_764_000_000 * 10**9, "Dance", "CC-BY-4.0", None)
    write_clip(tmp_path / "a.slod", [replace(state, metadata=facts) for state in states(2)])
    text = describe_file(tmp_path / "a.slod")
    for line in ("title: Dance", "licence: CC-BY-4.0", "unit: 0.5 m", "up: 0 -1 0", "begins: 2025-11-24 16:00:00 UTC"):
        assert f"\n{line}\n" in text
    far = replace(states(1)[0], metadata=Metadata(epoch_ns=-(2**62)))
    write_clip(tmp_path / "far.slod", [far])
    assert "\nbegins: " in describe_file(tmp_path / "far.slod")


def _total(text: str, heading: str) -> int:
    block = text.partition(heading)[2].partition("\n\n")[0].splitlines()[1:]
    return sum(int(number) for line in block for number in line.split()[-2:])
