"""Where fuzzing starts: the conformance vectors, their chunks, a file; and mutants of them from a seed."""

from __future__ import annotations

import gzip
import json
import random
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from streamlod.client.playback import Playback
from streamlod.codec.container import SlodWriter
from streamlod.codec.packet.bytes import parse
from streamlod.codec.snapshots import FORMATS
from streamlod.core.errors import BitstreamError
from tests.codec.imported.clouds import compressed_ply, some_cloud
from tests.fuzz.targets import CHUNKS, PACKET_TO_VIEWER, TEXT_TO_SERVER, TEXT_TO_VIEWER, addressed, joined, ready
from tests.vectors.make import FOLDER, read_stream


def packets() -> list[bytes]:
    """The last packet of every conformance stream, for the state that it belongs to."""
    return [addressed(number, last) for number, (_, last) in enumerate(ready())]


def chunks() -> list[bytes]:
    """The chunks of all packets that can be taken apart, for the decoder that each is meant for."""
    found = []
    for _, packet in ready():
        with suppress(BitstreamError):
            found += [
                addressed(CHUNKS.index(chunk.kind), chunk.data)
                for chunk in parse(packet).chunks
                if chunk.kind in CHUNKS
            ]
    return sorted(set(found))


def files() -> list[bytes]:
    """`.slod` files: with rows that come and go, in parts, with two keyframes."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("growth-profile1", "trickle", "second-keyframe"):
            path = Path(folder) / f"{name}.slod"
            with SlodWriter(path) as writer:
                for packet in read_stream(FOLDER / f"valid-{name}.slps"):
                    writer.append(packet)
            found.append(path.read_bytes())
    return found


def sessions() -> list[bytes]:
    """Whole sessions: a hello, a welcome, packets with events between them, and what viewers ask for."""
    welcome = {"type": "welcome", "version": 1, "stream": "main", "state": "live", "epoch": 1, "levels": 2, "fps": 30.0,
               "ack_every": 2}  # fmt: skip
    events = (
        {"type": "event", "event": "position", "mode": "live", "epoch": 1, "version": 0},
        {"type": "event", "event": "epoch", "epoch": 2},
        {"type": "event", "event": "levels", "levels": 1, "reason": "congestion"},
        {"type": "event", "event": "caught_up"},
    )
    asked = (
        {"type": "ack", "bytes": 1000, "epoch": 1, "version": 0},
        {"type": "set", "levels": 1, "kilobytes_per_second": 80.5},
        {"type": "seek", "to": {"epoch": 1, "version": 3}},
        {"type": "seek", "to": "live"},
        {"type": "pause"},
        {"type": "play"},
        {"type": "ack", "picture": 3},
    )
    hello = Playback().hello((1, 2), 3)
    found = []
    for path in sorted(FOLDER.glob("valid-*.slps")):
        said = [(TEXT_TO_SERVER, hello.encode()), (TEXT_TO_VIEWER, json.dumps(welcome).encode())]
        for number, packet in enumerate(read_stream(path)):
            said.append((PACKET_TO_VIEWER, packet))
            said.append((TEXT_TO_VIEWER, json.dumps(events[number % len(events)]).encode()))
        said += [(TEXT_TO_SERVER, json.dumps(message).encode()) for message in asked]
        found.append(joined([message for message in said if len(message[1]) < 1 << 16]))
    return found


def foreign() -> list[bytes]:
    """Files of another kind than ours: PLY, compressed PLY, and SPZ 3 and 4, the former's inside as well."""
    cloud = some_cloud(count=40)
    ply, spz, spz4 = (FORMATS[name].encode(cloud, "x") for name in ("ply", "spz", "spz4"))
    return [addressed(0, ply), addressed(0, compressed_ply(cloud)), *(addressed(1, data) for data in (spz, spz4)),
            addressed(2, gzip.decompress(spz))]  # fmt: skip


def kept() -> list[bytes]:
    """Inputs that once broke something, whatever the target: they never may again."""
    return [path.read_bytes() for path in sorted(KEPT.glob("*.bin"))]


KEPT = Path(__file__).parent / "found"
SEEDS = {"packet": packets, "entropy": chunks, "container": files, "session": sessions, "foreign": foreign}


def mutants(seeds: list[bytes], count: int, seed: int) -> Iterator[bytes]:
    """`count` damaged copies of `seeds`: flipped bits, odd numbers, cuts, insertions."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(rng.choice(seeds))
        for _ in range(rng.randrange(1, 5)):
            _damage(rng, data)
        yield bytes(data)


def _damage(rng: random.Random, data: bytearray) -> None:
    at = rng.randrange(len(data) + 1) if rng.random() < 0.75 else rng.randrange(min(len(data), 64) + 1)
    match rng.randrange(5):
        case 0 | 1 if at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        case 2 if at < len(data):
            data[at] = rng.choice((0, 1, 4, 127, 128, 255))
        case 3:
            del data[at : at + rng.randrange(1, 9)]
        case _:
            data[at:at] = rng.randbytes(rng.randrange(1, 9))
