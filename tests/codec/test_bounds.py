"""Bounds of what a packet costs: memory and work by its length, tried in processes of their own with little memory."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.limits import DecoderLimits
from streamlod.codec.packet.packet import PADDING, ChunkKind
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.keyframe import as_keyframe
from tests.codec.hostile import densest, hostile, stream_bytes
from tests.codec.scenes import make_scene, move
from tests.vectors.make import FOLDER, read_stream
from tests.vectors.valid import key, packet, small

_MEMORY = 192 << 20  # bytes that the process may take beside what Python and its libraries have taken
_CHILD = """
import os, resource, sys
from streamlod.codec.decoder import SceneDecoder
from streamlod.server.pipeline.warming import warm_codec
from streamlod.core.errors import BitstreamError
from tests.vectors.make import read_stream
from tests.work import lines
from pathlib import Path
if os.environ["NUMBA_DISABLE_JIT"] == "0":
    warm_codec()
for path in sys.argv[2:]:  # each in a fork of its own, which has loaded and compiled everything
    if (child := os.fork()) != 0:
        os.waitpid(child, 0)
        continue
    *before, last = read_stream(Path(path))
    decoder = SceneDecoder()
    for packet in before:
        decoder.push(packet)
    taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + int(sys.argv[1]),) * 2)
    with lines(10_000_000) as work:
        try:
            decoder.push(last)
            code = "accepted"
        except BitstreamError as error:
            code = error.code
    print(code, work.count, flush=True)
    os._exit(0)
"""


def _in_little_memory(folder: Path, streams: list[list[bytes]], *, compiled: bool) -> list[tuple[str, int]]:
    """Decode the last packet of each stream in a process that may take `_MEMORY` for it.

    Args:
        compiled: Numba's kernels are compiled, as they are in use; else they are Python whose lines count.

    Returns:
        A code or "accepted", and the lines of Python that were run, for each.
    """
    paths = [folder / f"{number}.slps" for number in range(len(streams))]
    for path, packets in zip(paths, streams, strict=True):
        path.write_bytes(stream_bytes(packets))
    command = [sys.executable, "-c", _CHILD, str(_MEMORY), *map(str, paths)]
    environment = os.environ | {"NUMBA_DISABLE_JIT": str(int(not compiled))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    found = [line.split() for line in done.stdout.splitlines()]
    assert (done.returncode, len(found)) == (0, len(streams)), done.stderr[-2000:]
    return [(code, int(count)) for code, count in found]


@pytest.mark.long
@pytest.mark.parametrize("compiled", [True, False])
def test_what_announces_too_much_costs_nothing(tmp_path: Path, compiled: bool) -> None:
    """It asks for little memory, and a refusal takes as many lines for a million rows as for ten thousand."""
    streams = hostile()
    costs = _in_little_memory(tmp_path, list(streams.values()), compiled=compiled)
    for (name, packets), (code, count) in zip(streams.items(), costs, strict=True):
        assert code == "limit_exceeded", name
        assert count < 30_000 + 5 * len(packets[-1]), name
    work = {name: count for name, (_, count) in zip(streams, costs, strict=True)}
    assert work["added for nothing"] == work["more added for nothing"]


@pytest.mark.long
def test_the_densest_packets_are_taken_in_little_memory(tmp_path: Path) -> None:
    """Rows for nothing, as many as the bytes allow."""
    ((code, _),) = _in_little_memory(tmp_path, [densest(40_000)], compiled=True)
    assert code == "accepted"


@pytest.mark.long
def test_the_densest_packets_cost_in_proportion(tmp_path: Path) -> None:
    """Four times the bytes take four times the work."""
    streams = [densest(rows) for rows in (250, 1_000)]
    first, second = _in_little_memory(tmp_path, streams, compiled=False)
    for packets, (code, count) in zip(streams, (first, second), strict=True):
        assert code == "accepted"
        assert count < 30_000 + 500 * len(packets[-1])
    assert second[1] < 4.1 * first[1]


def test_decoded_state_is_limited_in_bytes() -> None:
    scene = make_scene((5, 30))
    rows, row_bytes = sum(map(len, scene.levels)), scene.levels[0].row_bytes
    assert row_bytes == 87 + 2 * 32 + 6 * 4
    SceneDecoder(DecoderLimits(state_bytes=rows * row_bytes)).push(key(scene))
    with pytest.raises(BitstreamError) as refused:
        SceneDecoder(DecoderLimits(state_bytes=rows * row_bytes - 1)).push(key(scene))
    assert refused.value.code == "limit_exceeded"


@pytest.mark.parametrize("profile", [0, 1])
def test_the_encoder_pads_what_would_be_refused(profile: int) -> None:
    """What an encoder writes is never refused for having too few bytes, however alike its rows are."""
    packets = read_stream(FOLDER / f"valid-padding-profile{profile}.slps")
    padded = [any(chunk.kind == PADDING for chunk in parse(data).chunks) for data in packets]
    assert any(padded)
    decoder = SceneDecoder()
    for data in packets:
        decoder.push(data)
    bare = parse(packets[padded.index(True)])
    bare = replace(bare, chunks=tuple(chunk for chunk in bare.chunks if chunk.kind != PADDING))
    again = SceneDecoder()
    for data in packets[: padded.index(True)]:
        again.push(data)
    with pytest.raises(BitstreamError) as refused:
        again.push(build(bare))
    assert refused.value.code == "limit_exceeded"


def test_a_key_part_of_another_run_is_refused() -> None:
    first, second = replace(small(), identifier=7), replace(small(seed=1), identifier=8)
    decoder = SceneDecoder()
    decoder.push(key(first))
    for data in (packet(second, move(second)), _part(second)):
        with pytest.raises(BitstreamError) as refused:
            decoder.push(data)
        assert refused.value.code == "unknown_keyframe"
    assert decoder.scene is not None
    assert decoder.scene.identifier == 7


def _part(scene: Scene) -> bytes:
    """The second level of a keyframe alone."""
    parsed = parse(key(scene))
    return build(replace(parsed, level_mask=2, chunks=tuple(c for c in parsed.chunks if c.level == 1)))


@pytest.mark.parametrize("column", AnchorLevel.__slots__)
def test_the_state_hash_sees_every_column(column: str) -> None:
    """A decoder whose state differs in one number of any column learns it with the keyframe or the next packet."""
    level = small().levels[1]
    values = getattr(level, column).copy()
    values.reshape(-1)[-1] ^= 1
    assert replace(level, **{column: values}).digest() != level.digest()


def test_hashes_come_with_a_keyframe_after_it_and_over_more_than_one_version() -> None:
    scene = small()
    second, third = move(scene), move(move(scene))
    later = replace(third, version=30)

    def hashed(data: bytes) -> bool:
        return any(chunk.kind == ChunkKind.HASH for chunk in parse(data).chunks)

    assert hashed(key(scene))
    assert hashed(packet(scene, second))
    assert not hashed(packet(second, third))
    assert hashed(packet(scene, third))
    assert hashed(packet(replace(third, version=29), later))


def test_two_runs_over_one_clip_cannot_be_mixed() -> None:
    """Equal keyframes of two runs have different identifiers, so that neither decoder takes the other's changes."""
    first, second = (as_keyframe(make_scene((5, 30)), 0) for _ in range(2))
    assert [level.digest() for level in first.levels] == [level.digest() for level in second.levels]
    decoder = SceneDecoder()
    decoder.push(key(first))
    with pytest.raises(BitstreamError) as refused:
        decoder.push(packet(second, move(second)))
    assert refused.value.code == "unknown_keyframe"
    decoder.push(packet(first, move(first)))
