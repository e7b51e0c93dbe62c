"""Where fuzzing starts: the conformance vectors, their chunks, a file; and mutants of them from a seed."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from codec.container import SlodWriter
from codec.packet import parse
from core.errors import BitstreamError
from tests.vectors.make import FOLDER, read_stream


def packets() -> list[bytes]:
    """The last packet of every conformance stream."""
    return [read_stream(path)[-1] for path in sorted(FOLDER.glob("*.slps"))]


def chunks() -> list[bytes]:
    """The chunks of all packets that can be taken apart."""
    found = []
    for packet in packets():
        try:
            found += [chunk.data for chunk in parse(packet).chunks if chunk.kind > 1]
        except BitstreamError:
            continue
    return sorted(set(found))


def files() -> list[bytes]:
    """A `.slod` file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.slod"
        with SlodWriter(path) as writer:
            for packet in read_stream(FOLDER / "valid-growth-profile1.slps"):
                writer.append(packet)
        return [path.read_bytes()]


SEEDS = {"packet": packets, "entropy": chunks, "container": files}


def mutants(seeds: list[bytes], count: int, seed: int) -> Iterator[bytes]:
    """`count` damaged copies of `seeds`: flipped bits, odd numbers, cuts, insertions."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(rng.choice(seeds))
        for _ in range(rng.randrange(1, 5)):
            _damage(rng, data)
        yield bytes(data)


def _damage(rng: random.Random, data: bytearray) -> None:
    at = rng.randrange(len(data) + 1) if rng.random() < 0.5 else rng.randrange(min(len(data), 64) + 1)
    match rng.randrange(5):
        case 0 | 1 if at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        case 2 if at < len(data):
            data[at] = rng.choice((0, 1, 4, 127, 128, 255))
        case 3:
            del data[at : at + rng.randrange(1, 9)]
        case _:
            data[at:at] = rng.randbytes(rng.randrange(1, 9))
