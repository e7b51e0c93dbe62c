"""The conformance vectors hold for this decoder; `node --test` runs the same manifest."""

from __future__ import annotations

import json
from typing import Any

import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.limits import COMPLEXITY_LEVELS
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.residual import difference
from tests.vectors.make import FOLDER, facts_of, read_file, read_stream, state_of

MANIFEST: dict[str, Any] = json.loads((FOLDER / "manifest.json").read_text())


@pytest.mark.parametrize("vector", MANIFEST["valid"], ids=lambda v: v["name"])
def test_valid(vector: dict[str, Any]) -> None:
    decoder = SceneDecoder()
    for packet, state in zip(read_stream(FOLDER / vector["file"]), vector["states"], strict=True):
        decoder.push(packet)
        assert state_of(decoder) == state
    assert facts_of(decoder) == vector.get("metadata", {})


def test_all_vectors_are_within_the_smallest_complexity_level() -> None:
    for vector in MANIFEST["valid"]:
        decoder = SceneDecoder(COMPLEXITY_LEVELS["small"])
        for packet in read_stream(FOLDER / vector["file"]):
            decoder.push(packet)
        assert state_of(decoder) == vector["states"][-1]


@pytest.mark.parametrize("vector", MANIFEST["broken"], ids=lambda v: v["name"])
def test_broken(vector: dict[str, Any]) -> None:
    *packets, last = read_stream(FOLDER / vector["file"])
    decoder = SceneDecoder()
    for packet in packets:
        decoder.push(packet)
    before = state_of(decoder)
    with pytest.raises(BitstreamError) as refused:
        decoder.push(last)
    assert refused.value.code == vector["refused"]
    assert state_of(decoder) == before


@pytest.mark.parametrize("vector", MANIFEST["files"], ids=lambda v: v["name"])
def test_file(vector: dict[str, Any]) -> None:
    """Index, order of packets, and the way to each version; also for files whose index is wrong."""
    found = read_file(FOLDER / vector["file"])
    assert {"name": vector["name"], "file": vector["file"], **found} == vector


def test_every_refusal_code_has_a_vector() -> None:
    codes = {"bad_file", "too_large"} | {vector["refused"] for vector in MANIFEST["broken"]}
    text = (FOLDER.parents[1] / "codec" / "FORMAT.md").read_text()
    section = text.split("## 13. Refusals")[1].split("The first check that fails")[0]
    documented = {line.split("|")[1].strip() for line in section.splitlines() if line.startswith("| ")} - {
        "code",
        "---",
    }
    assert codes == documented


@pytest.mark.parametrize(
    "name", ["chain-profile1", "growth-profile1", "four-lanes", "everything-moves", "extremes-profile1"]
)
def test_the_encoder_writes_the_same_bytes_again(name: str) -> None:
    """The vectors pin the encoder too: states read from them are coded to the very bytes that they came from."""
    decoder = SceneDecoder()
    for packet in read_stream(FOLDER / f"valid-{name}.slps"):
        before, info = decoder.scene, decoder.push(packet)
        assert decoder.scene is not None
        if before is None or info.kind is PacketKind.KEY:
            again = encode_keyframe(decoder.scene, time_ns=info.time_ns)
        else:
            residual = difference(before, decoder.scene)
            again = encode_residual(before, residual, time_ns=info.time_ns)
        assert again == packet
