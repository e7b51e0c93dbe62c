"""Conformance vectors: `python -m tests.vectors.make` writes the streams and manifest.json into this folder.

What the files hold is said in codec/FORMAT.md section 16.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

from codec.decoder import SceneDecoder
from core.errors import BitstreamError
from core.scene.anchors import AnchorLevel
from tests.vectors.broken import broken_streams
from tests.vectors.valid import valid_streams

FOLDER = Path(__file__).parent


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


def main() -> None:
    """Write all streams and the manifest."""
    for old in FOLDER.glob("*.slps"):
        old.unlink()
    valid, broken = [], []
    for name, packets in valid_streams():
        decoder, states = SceneDecoder(), []
        for packet in packets:
            decoder.push(packet)
            states.append(state_of(decoder))
        valid.append({"name": name, "file": _write_stream(f"valid-{name}", packets), "states": states})
    for name, packets, code in broken_streams():
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
        broken.append({"name": name, "file": _write_stream(f"broken-{name}", packets), "refused": code})
    manifest = {"format": 1, "valid": valid, "broken": broken}
    (FOLDER / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")


if __name__ == "__main__":
    main()
