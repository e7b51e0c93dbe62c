"""Conformance vectors: `python -m tests.vectors.make` writes new streams into this folder, and manifest.json.

What the files hold is said in codec/FORMAT.md section 16. Those that frozen.json lists stay as they are, also where
this encoder would write the same states in other bytes.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.anchors import AnchorLevel
from streamlod.core.scene.metadata import Metadata
from tests.vectors.broken import broken_streams
from tests.vectors.files import file_vectors
from tests.vectors.valid import valid_streams

FOLDER = Path(__file__).parent
FROZEN = FOLDER / "frozen.json"


def level_hash(level: AnchorLevel) -> str:
    """SHA-256 of a level's state, in hexadecimal."""
    digest = hashlib.sha256()
    for column in level.state():
        digest.update(column)
    return digest.hexdigest()


def state_of(decoder: SceneDecoder) -> dict[str, list[int] | list[str]]:
    """What the manifest says of a decoder's state."""
    levels = () if decoder.scene is None else decoder.scene.levels
    return {"versions": list(decoder.versions), "levels": [level_hash(level) for level in levels]}


def facts_of(decoder: SceneDecoder) -> dict[str, Any]:
    """What the manifest says of a scene's metadata."""
    facts = Metadata() if decoder.scene is None else decoder.scene.metadata
    original = facts.original and [facts.original.scale, *facts.original.rotation, *facts.original.translation]
    named = {
        "unit": facts.metres_per_unit,
        "up": facts.up and list(facts.up),
        "epoch": None if facts.epoch_ns is None else str(facts.epoch_ns),
        "title": facts.title,
        "licence": facts.licence,
        "original": original,
        "exposures": facts.exposures and [[*exposure.gain, *exposure.offset] for exposure in facts.exposures],
    }
    return {name: value for name, value in named.items() if value is not None}


def read_stream(path: Path) -> list[bytes]:
    """The packets of a stream file."""
    data, at, packets = path.read_bytes(), 0, []
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        packets.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    return packets


def _write_stream(name: str, packets: list[bytes]) -> str:
    path = FOLDER / f"{name}.slps"
    path.write_bytes(b"".join(struct.pack("<I", len(packet)) + packet for packet in packets))
    return path.name


def _valid(name: str, packets: list[bytes]) -> dict[str, Any]:
    """The manifest's entry of a stream, which is written."""
    decoder, states = SceneDecoder(), []
    for packet in packets:
        decoder.push(packet)
        states.append(state_of(decoder))
    facts = facts_of(decoder)
    entry = {"name": name, "file": _write_stream(f"valid-{name}", packets), "states": states}
    return {**entry, "metadata": facts} if facts else entry


def _broken(name: str, packets: list[bytes], code: str) -> dict[str, Any]:
    """Likewise, for a stream whose last packet must be refused with this code."""
    decoder = SceneDecoder()
    for packet in packets[:-1]:
        decoder.push(packet)
    try:
        decoder.push(packets[-1])
    except BitstreamError as error:
        if error.code != code:
            raise ValueError(f"{name} is refused as {error.code}, not as {code}") from error
    else:
        raise ValueError(f"{name} is not refused")
    return {"name": name, "file": _write_stream(f"broken-{name}", packets), "refused": code}


def read_file(path: Path) -> dict[str, Any]:
    """What the manifest says of a `.slod` file, as this reader and decoder have it."""
    with SlodReader(path) as reader:
        versions = sorted({entry.to_version for entry in reader.entries})
        content = path.read_bytes()
        return {
            "indexed": not reader.torn and reader.records_end < len(content),
            "packets": len(reader.entries),
            "in_order": _decoded(reader, range(len(reader.entries))),
            "ways": {str(version): _way(reader, version) for version in versions},
        }


def _way(reader: SlodReader, version: int) -> dict[str, Any] | None:
    try:
        numbers = reader.plan(version)
    except InputError:
        return None
    return {"numbers": list(numbers), **_decoded(reader, numbers)}


def _decoded(reader: SlodReader, numbers: Sequence[int]) -> dict[str, Any]:
    """The state after these packets, without those that are refused as `version_mismatch`; or the first refusal."""
    decoder = SceneDecoder()
    for number in numbers:
        try:
            decoder.push(reader.read(number))
        except BitstreamError as error:
            if error.code != "version_mismatch":
                return {"refused": error.code, "packet": number}
    return state_of(decoder)


def _file(name: str, content: bytes) -> dict[str, Any]:
    path = FOLDER / f"file-{name}.slod"
    path.write_bytes(content)
    return {"name": name, "file": path.name, **read_file(path)}


def main() -> None:
    """Write the streams that are not frozen, and the manifest of all."""
    frozen, path = json.loads(FROZEN.read_text())["streams"], FOLDER / "manifest.json"
    manifest = json.loads(path.read_text())
    for old in FOLDER.glob("*.slps"):
        if old.name not in frozen:
            old.unlink()
    for kind in ("valid", "broken"):
        manifest[kind] = [entry for entry in manifest[kind] if entry["file"] in frozen]
    made = (_valid(*stream) for stream in valid_streams() if f"valid-{stream[0]}.slps" not in frozen)
    manifest["valid"] += made
    refused = (_broken(*stream) for stream in broken_streams() if f"broken-{stream[0]}.slps" not in frozen)
    manifest["broken"] += refused
    for old in FOLDER.glob("file-*.slod"):
        old.unlink()
    manifest["files"] = [_file(*file) for file in file_vectors()]
    path.write_text(json.dumps(manifest, indent=1) + "\n")


if __name__ == "__main__":
    main()
