"""Peak memory of decoding against input size: ``python -m tests.bench.decode_memory [PLOT.png]``.

For each complexity level of codec/FORMAT.md section 13, keyframes and changes of more and more bytes: ordinary ones,
and the densest that a decoder accepts. Each is decoded in a process of its own, which has loaded and compiled
everything before. Printed are the peak beyond that, and the bytes of it for each byte of input beyond the level's
fixed base of four times its limit of state.
"""

from __future__ import annotations

import os
import resource
import struct
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from streamlod.codec.chunks.plain import encode_plain
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.limits import COMPLEXITY_LEVELS, MAX_NUMBERS_A_BYTE
from streamlod.codec.packet.packet import PADDING, ChunkKind, make_chunk
from streamlod.core.errors import BitstreamError
from streamlod.server.pipeline.warming import warm_codec
from tests.codec import oracle
from tests.codec.hostile import densest
from tests.codec.scenes import make_scene, move
from tests.vectors.make import read_stream
from tests.vectors.valid import key, packet

BASE_STATES = 4  # the base is this many times the state that the level allows
_ROWS = (4_000, 16_000, 64_000, 128_000, 250_000, 500_000, 1_000_000)


def inputs(rows: int) -> Iterator[tuple[str, list[bytes]]]:
    """Name and packets of each stream of about `rows` rows; the peak is that of the last packet."""
    yield "dense key", [dense_key(rows)]
    yield "dense key, deflate", [dense_key(rows, plain=True)]
    yield "dense added", densest(rows)
    if rows == _ROWS[0]:
        scene = make_scene((rows // 8, rows - rows // 8))
        yield "ordinary key", [key(scene)]
        yield "ordinary change", [key(scene), packet(scene, move(scene, share=0.5))]


def dense_key(rows: int, *, plain: bool = False) -> bytes:
    """A keyframe of `rows` rows that cost nothing, in as few bytes as are accepted."""
    scene = make_scene((5, 5), slots=1, features=2)
    channels, whole = 2 + 3 + 10, parse(key(scene))
    voxels = np.zeros((rows, 3), np.int32)
    words = np.array(oracle.Encoder().words(1), "<u2").tobytes()
    uncoded = bytes([1]) + bytes(-(-channels // 4)) + b"\1" + bytes(1 + -(-channels // 2)) + words
    base = encode_plain(np.zeros((rows, channels), np.int32)) if plain else uncoded
    own = [make_chunk(1, ChunkKind.GEOMETRY, encode_plain(voxels)), make_chunk(1, ChunkKind.BASE, base)]
    missing = -(-rows * channels // MAX_NUMBERS_A_BYTE) - sum(len(chunk.data) for chunk in own)
    own += [make_chunk(1, PADDING, bytes(missing))] if missing > 0 else []
    return build(replace(whole, chunks=(*(c for c in whole.chunks if c.level == 0), *own)))


def peak(path: str, level: str) -> tuple[int, str]:
    """Bytes that decoding the last packet takes at its peak beyond what was there before, and what came of it."""
    decoder, packets = SceneDecoder(COMPLEXITY_LEVELS[level]), read_stream(Path(path))
    try:
        for data in packets[:-1]:
            decoder.push(data)
    except BitstreamError as error:
        return 0, error.code
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = _status("VmRSS")
    try:
        decoder.push(packets[-1])
        result = "accepted"
    except BitstreamError as error:
        result = error.code
    return max(_status("VmHWM") - before, 0), result


def _status(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) << 10


def main() -> None:
    """Measure, print, and plot where a file is given."""
    os.environ["MALLOC_MMAP_THRESHOLD_"] = "65536"  # memory that is given back is not counted again
    warm_codec()
    found: list[tuple[str, str, int, int]] = []
    print("level  input                 bytes in  peak MiB  result          bytes a byte beyond the base")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        for rows in _ROWS:
            for name, packets in inputs(rows):
                path.write_bytes(b"".join(struct.pack("<I", len(data)) + data for data in packets))
                size = len(packets[-1])
                for level, limits in COMPLEXITY_LEVELS.items():
                    with get_context("fork").Pool(1) as pool:
                        taken, result = pool.apply(peak, (str(path), level))
                    beyond = max(0, taken - BASE_STATES * limits.state_bytes) / size
                    found.append((level, name, size, taken))
                    print(f"{level:6} {name:20} {size:9d} {taken / 2**20:9.1f}  {result:15} {beyond:6.1f}", flush=True)
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(f"the process that all were forked from: {usage} MiB")
    if len(sys.argv) > 1:
        plot(found, Path(sys.argv[1]))


def plot(found: list[tuple[str, str, int, int]], path: Path) -> None:
    """Peak against input size, one panel a complexity level."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4), layout="constrained")
    panels = figure.subplots(1, len(COMPLEXITY_LEVELS), sharey=True)
    for panel, (level, limits) in zip(panels, COMPLEXITY_LEVELS.items(), strict=True):
        for name in dict.fromkeys(row[1] for row in found):
            points = [(size / 1e3, taken / 2**20) for own, n, size, taken in found if (own, n) == (level, name)]
            panel.plot(*zip(*sorted(points), strict=True), marker="o", label=name)
        panel.axhline(BASE_STATES * limits.state_bytes / 2**20, color="black", linestyle="--", label="base")
        panel.set(title=level, xlabel="input, KB", xscale="log", yscale="log")
    panels[0].set_ylabel("peak memory, MiB")
    panels[-1].legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
