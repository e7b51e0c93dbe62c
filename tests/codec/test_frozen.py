"""Version 1 is frozen: files of that day decode for ever to the states of that day. FORMAT.md section 18."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.bytes import FORMAT_VERSION, parse
from streamlod.core.errors import BitstreamError
from tests.vectors.make import FOLDER, FROZEN, read_stream, state_of

# Whoever changes this number changes what version 1 means. New vectors go into the manifest, not into this list.
LIST = "9116a571eef352c754f1df7ea5f72a186ae232419bb0fe4a8e1d4ceaa03636a7"
GOLDEN: dict[str, Any] = json.loads(FROZEN.read_text())


def _sum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_the_list_is_that_of_the_day() -> None:
    assert _sum(FROZEN.read_bytes()) == LIST


def test_every_file_holds_the_bytes_of_the_day() -> None:
    files = GOLDEN["streams"] | {name: recording["bytes"] for name, recording in GOLDEN["recordings"].items()}
    assert {name: _sum((FOLDER / name).read_bytes()) for name in files} == files


def test_the_manifest_expects_the_states_and_refusals_of_the_day() -> None:
    """So that `test_vectors` and its like in JavaScript hold each decoder to them."""
    manifest = json.loads((FOLDER / "manifest.json").read_text())
    entries = [e for kind in ("valid", "broken") for e in manifest[kind] if e["file"] in GOLDEN["streams"]]
    assert len(entries) == len(GOLDEN["streams"]) >= 193
    assert _sum(json.dumps(entries, sort_keys=True).encode()) == GOLDEN["expected"]


@pytest.mark.parametrize("name", GOLDEN["recordings"])
@pytest.mark.parametrize("indexed", [True, False])
def test_every_version_of_a_recording_is_what_it_was(tmp_path: Path, name: str, indexed: bool) -> None:
    """By its index, and by walking its records where the index is lost."""
    path = tmp_path / name
    path.write_bytes((FOLDER / name).read_bytes()[: None if indexed else -1])
    with SlodReader(path) as reader:
        assert reader.torn is not indexed
        assert len(reader.entries) == GOLDEN["recordings"][name]["packets"]
        for version, state in GOLDEN["recordings"][name]["states"].items():
            decoder = SceneDecoder()
            for number in reader.plan(int(version)):
                decoder.push(reader.read(number))
            assert state_of(decoder) == state


def test_a_recording_has_keyframes_and_what_follows_them() -> None:
    with SlodReader(FOLDER / "recording.slod") as reader:
        assert len({entry.keyframe for entry in reader.entries}) == 2


def test_a_packet_of_a_later_version_is_refused_whatever_else_it_holds() -> None:
    """Only length and magic are looked at before: everything behind the version may mean something else then."""
    packet = read_stream(FOLDER / "valid-growth-profile1.slps")[0]
    for version in (0, FORMAT_VERSION + 1, 255):
        for rest in (packet[5:], b"\xff" * 60):
            with pytest.raises(BitstreamError) as refused:
                parse(packet[:4] + bytes([version]) + rest)
            assert refused.value.code == "unsupported_version"


def test_a_file_of_a_later_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "later.slod"
    content = (FOLDER / "growth.slod").read_bytes()
    for version in (0, 2, 255):
        path.write_bytes(content[:4] + bytes([version]) + content[5:])
        with pytest.raises(BitstreamError) as refused:
            SlodReader(path)
        assert refused.value.code == "unsupported_version"
