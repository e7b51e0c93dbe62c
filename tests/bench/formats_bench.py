"""Bytes of one clip in each format that streamlod writes: ``python -m tests.bench.formats_bench SCENE.slod``.

Printed are the bytes of the whole clip, those of one more frame (the mean of all behind the first), and those that are
read to show the frame in the middle from nothing. Everything but `.slod` and MP4 holds plain Gaussians, with colours as
seen on average from the rig's cameras.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from streamlod.client.commands import AVERAGE, export
from streamlod.client.recording import versions
from streamlod.codec.container import SlodReader
from streamlod.codec.mp4 import Mp4Reader

_SEQUENCES = ("ply", "spz", "glb")
_KB = 1000


@dataclass(frozen=True, slots=True)
class Size:
    """Bytes of a clip in one format; None where a part cannot be told from the file."""

    name: str
    whole: int
    first: int | None
    middle: int | None


def sizes(scene: Path, folder: Path) -> Iterator[Size]:
    """The clip in each format, written below `folder`."""
    held = versions(scene)
    middle = held[len(held) // 2]
    with SlodReader(scene) as slod:
        first = sum(slod.entries[number].size_bytes for number in slod.plan(held[0]))
        read = sum(slod.entries[number].size_bytes for number in slod.plan(middle))
    yield Size(".slod", scene.stat().st_size, first, read)
    export(scene, 0, AVERAGE, "mp4", folder / "clip.mp4")
    with Mp4Reader(folder / "clip.mp4") as mp4:
        read = sum(mp4.entries[number].size_bytes for number in mp4.plan(middle))
    yield Size("MP4 with our packets", (folder / "clip.mp4").stat().st_size, first, read)
    for name, suffix in (("4dgs", ".4dgs"), ("usd", ".usdc")):
        path = folder / f"clip{suffix}"
        export(scene, held[0], AVERAGE, name, path)
        yield Size(suffix, path.stat().st_size, None, None)
    for name in _SEQUENCES:
        export(scene, held[0], AVERAGE, name, folder / name, sequence=True)
        files = sorted((folder / name).iterdir())
        each = [file.stat().st_size for file in files]
        yield Size(f"a .{name} a frame", sum(each), each[0], each[len(each) // 2])


def main(scene: Path) -> None:
    """Print the table."""
    count = len(versions(scene))
    print(f"{scene.name}: {count} frames\n")
    print("| | whole, KB | first frame, KB | each further one, KB | read to show the middle one, KB |")
    print("| --- | --- | --- | --- | --- |")
    with TemporaryDirectory() as folder:
        for size in sizes(scene, Path(folder)):
            later = None if size.first is None or count < 2 else (size.whole - size.first) / (count - 1)
            cells = (size.whole, size.first, later, size.middle)
            texts = (f"{cell / _KB:.1f}" if cell is not None else "" for cell in cells)
            print(f"| {size.name} | {' | '.join(texts)} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
