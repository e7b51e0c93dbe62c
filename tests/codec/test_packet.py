"""Packets as envelopes: describing, selecting and splitting levels, what cannot be built; scene headers and weights."""

from __future__ import annotations

import struct
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.codec.chunks.header import decode_header, decode_weights, encode_header, encode_weights
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.levels import drop_levels, select_levels, split_levels
from streamlod.codec.packet.limits import DEFAULT_LIMITS
from streamlod.codec.packet.packet import Packet, PacketKind, make_chunk
from streamlod.core.scene.anchors import AnchorWeights
from streamlod.core.scene.residual import difference
from tests.codec.scenes import make_scene, move
from tests.vectors.valid import key, packet, small

SCENE = make_scene((6, 30, 90))
KEY = key(SCENE)
NEXT = move(SCENE)
PREDICTED = packet(SCENE, NEXT)


def test_the_bytes_of_the_envelope() -> None:
    """An independent reading of FORMAT.md section 2."""
    fixed = struct.unpack("<4sBBBBIIIQHHQI", PREDICTED[:44])
    assert fixed[:11] == (b"SLPK", 1, 1, 1, 0, 0, 0, 1, 33_366_700, 0b111, 6)
    entries = struct.unpack("<12I", PREDICTED[44:92])
    assert [word >> 24 for word in entries[::2]] == [0x04, 0x07, 0x14, 0x17, 0x24, 0x27]
    assert sum(word & 0xFFFFFF for word in entries[::2]) + 92 == len(PREDICTED)


@pytest.mark.parametrize("data", [KEY, PREDICTED])
def test_peek_accounts_for_every_byte(data: bytes) -> None:
    info = peek(data)
    chunks = len(parse(data).chunks)
    assert info.size_bytes == len(data) == 44 + 8 * chunks + sum(info.chunk_bytes.values())
    scene = info.chunk_bytes.get("header", 0) + info.chunk_bytes.get("weights", 0)
    assert sum(info.level_bytes) == sum(info.chunk_bytes.values()) - scene
    assert info.has_header == (data is KEY)


def test_levels_drop_and_split_without_a_trace() -> None:
    assert drop_levels(KEY, 2) == KEY
    assert drop_levels(drop_levels(KEY, 1), 0) == drop_levels(KEY, 0)
    parts = split_levels(KEY)
    assert [peek(part).level_mask for part in parts] == [1, 2, 4]
    assert sum(map(len, parts)) == len(KEY) + 2 * 44
    assert select_levels(PREDICTED, 0b110) == build(
        replace(parse(PREDICTED), level_mask=6, chunks=parse(PREDICTED).chunks[2:])
    )
    with pytest.raises(ValueError, match="no level"):
        select_levels(split_levels(PREDICTED)[2], 0b011)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=40)), max_size=4, unique_by=lambda c: c[0]))
def test_building_and_parsing_are_inverse(contents: list[tuple[int, bytes]]) -> None:
    chunks = tuple(make_chunk(level, 4, data) for level, data in sorted(contents))
    whole = Packet(PacketKind.CHANGE, 1, 3, 5, 2**32 - 1, 2**63 - 1, 15, 2**64 - 1, chunks)
    assert parse(build(whole)) == whole


@pytest.mark.parametrize(
    "change",
    [
        {"level_mask": 0},
        {"level_mask": 1 << 16},
        {"to_version": 2**32},
        {"to_version": 0},
        {"time_ns": -1},
        {"keyframe": 1},
    ],
)
def test_impossible_packets_are_not_built(change: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"mask|version|time"):
        build(replace(parse(PREDICTED), **change))  # type: ignore[arg-type]


def test_the_encoder_refuses_what_is_no_keyframe() -> None:
    scene = small()
    with pytest.raises(ValueError, match="as_keyframe"):
        encode_keyframe(move(scene), time_ns=0)
    with pytest.raises(ValueError, match="as_keyframe"):
        encode_keyframe(replace(move(scene, share=1.0), version=0), time_ns=0)
    with pytest.raises(ValueError, match="does not fit"):
        encode_residual(move(scene), difference(scene, move(scene)), time_ns=0)


def test_header_and_weights_come_back_to_the_bit() -> None:
    header = decode_header(encode_header(SCENE.header), DEFAULT_LIMITS)
    assert encode_header(header) == encode_header(SCENE.header)
    assert header.octree.root_cell == SCENE.header.octree.root_cell
    assert [camera.name for camera in header.cameras] == ["cam00", "cam01"]
    for ours, theirs in zip(SCENE.header.cameras, header.cameras, strict=True):
        np.testing.assert_array_equal(ours.world_to_camera, theirs.world_to_camera)
        np.testing.assert_array_equal(ours.intrinsics, theirs.intrinsics)
    weights = decode_weights(encode_weights(SCENE.weights), header)
    for name in AnchorWeights.__slots__:
        np.testing.assert_array_equal(getattr(SCENE.weights, name), getattr(weights, name))


@pytest.mark.parametrize("value", [0.1, 1e6, np.nan, np.inf])
def test_weights_must_be_exact_in_float16(value: float) -> None:
    bias = SCENE.weights.hidden_bias.copy()
    bias[3] = value
    with pytest.raises(ValueError, match="hidden_bias"):
        encode_weights(replace(SCENE.weights, hidden_bias=bias))


def test_headers_that_cannot_be_sent() -> None:
    header = SCENE.header
    camera = header.cameras[0]
    for wrong in (
        replace(header, fps=0.0),
        replace(header, feature_steps=header.feature_steps * np.float32(-1)),
        replace(header, cameras=(replace(camera, name="x" * 65),)),
        replace(header, cameras=(replace(camera, width=70_000),)),
    ):
        with pytest.raises(ValueError, match=r"header|name"):
            encode_header(wrong)


def test_the_codec_needs_no_heavy_library() -> None:
    heavy = "[m for m in ('torch', 'fastapi') if m in sys.modules]"
    code = f"import sys, codec.decoder, codec.encoder, codec.container; print({heavy})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
