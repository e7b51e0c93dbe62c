"""Conformance vectors: `python -m tests.vectors.make` writes the streams and manifest.json into this folder.

A stream file is a sequence of ``u32 size, packet`` (little-endian). For a stream of ``valid``, a decoder with the
default limits accepts every packet, and after packet i the versions and the SHA-256 of each level are those of
``states[i]``; an absent level counts as one without rows. The hash is over, one after the other, each row-major and
little-endian: voxel i32, position i32, feature i16, offset i16, scaling i16, extra_level i16, latent i16, alive u8.
For a stream of ``broken``, all packets but the last are accepted, and the last is refused with code ``refused``, the
state staying as it was.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

import numpy as np

from codec.decoder import SceneDecoder
from core.errors import BitstreamError
from core.scene.anchors import AnchorLevel
from tests.vectors.broken import broken_streams
from tests.vectors.valid import valid_streams

FOLDER = Path(__file__).parent
_COLUMNS = (
    ("voxel", "<i4"),
    ("position", "<i4"),
    ("feature", "<i2"),
    ("offset", "<i2"),
    ("scaling", "<i2"),
    ("extra_level", "<i2"),
    ("latent", "<i2"),
    ("alive", "u1"),
)


def level_hash(level: AnchorLevel) -> str:
    """SHA-256 of a level's integers, in hexadecimal."""
    digest = hashlib.sha256()
    for name, dtype in _COLUMNS:
        digest.update(np.ascontiguousarray(getattr(level, name)).astype(dtype).tobytes())
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
