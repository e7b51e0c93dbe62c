"""What other tables would save: ``python -m tests.bench.codec_tables FILE.slod...``.

Counts which symbols occur in which bin, apart for each file and kind of number, and finds the tables whose largest
excess over the tables that each of these would have of its own is least. Fitted to even frames, judged on odd ones,
beside the tables of version 1 of the format, which are final.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from streamlod.codec.chunks import columns
from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.chunks.matrices import base_matrix, shifted_of
from streamlod.codec.coder.change_model import position_errors, steady_motion
from streamlod.codec.coder.entropy import encode_scales, scale_of
from streamlod.core.arrays import Float64, Int64
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.entropy_model import BINS, ESCAPE, FREQUENCIES, SCALES, SYMBOLS, UNIT_BIN
from streamlod.core.scene.residual import difference
from tests.bench.codec_bench import load
from tests.codec import oracle

_SKIP = 4  # frames of the skips that tables are fitted to, too
_ROUNDS = 3000
_WEIGHT = 1e5  # symbols that each group counts as
_PRIOR = 60.0  # symbols of the geometric law in each bin


class Counter:
    """A coder of `tests.codec.oracle` that writes nothing: it counts symbols [BINS,SYMBOLS]."""

    def __init__(self) -> None:
        self.counts = np.zeros((BINS, SYMBOLS))
        self._bins = {tuple(row): number for number, row in enumerate(FREQUENCIES.tolist())}

    def interval(self, frequencies: Sequence[int], symbol: int | None) -> int:
        """Count a symbol of a frozen table."""
        if symbol is None:
            raise ValueError("a counter must be told what to count")
        if len(frequencies) == SYMBOLS:
            self.counts[self._bins[tuple(frequencies)], symbol] += 1
        return symbol


def keyframe_counts(scene: Scene) -> Float64:
    """[BINS,SYMBOLS] of all levels' BASE chunks."""
    counter = Counter()
    for level in scene.levels:
        _, _, used, classes, values = columns.classed(base_matrix(level), shifted_of(level))
        scales = [encode_scales(values[classes == k])[1].tolist() for k in range(len(used))]
        oracle.classed_columns(counter, len(values), scales, (classes.tolist(), values.tolist()))
    return counter.counts


def change_counts(before: Scene, after: Scene) -> tuple[Float64, Float64]:
    """[BINS,SYMBOLS] of positions and of latents in the packet between two states."""
    positions, latents, residual = Counter(), Counter(), difference(before, after)
    elapsed = Elapsed(before.version - before.keyframe, after.version - before.version)
    for level, change in zip(before.levels, residual.levels, strict=True):
        if not len(change.rows):
            continue
        motion = steady_motion(level.position, change.rows, elapsed.age, elapsed.span)
        errors = position_errors(change.position.astype(np.int64), motion)
        scale = int(SCALES[scale_of(float(np.abs(errors).mean()))])
        oracle.positions(positions, motion.tolist(), scale, change.position.tolist())
        scales = encode_scales(change.latent[change.latent.any(axis=1)])[1]
        oracle.latents(latents, level.latent[change.rows].tolist(), scales.tolist(), change.latent.tolist())
    return positions.counts, latents.counts


def groups(path: Path) -> Iterator[tuple[str, Float64]]:
    """Name and counts [2,BINS,SYMBOLS], of even and odd frames, of each kind of number in a file."""
    states = load(path).states
    yield "keyframe", np.stack([keyframe_counts(states[0])] * 2)
    for name, reach in (("predicted", 1), ("skip", _SKIP)):
        sums = np.zeros((2, 2, BINS, SYMBOLS))
        for number, (before, after) in enumerate(zip(states, states[reach:], strict=False)):
            if number % reach == 0:
                sums[:, number // reach % 2] += np.stack(change_counts(before, after))
        yield from zip((f"{name} positions", f"{name} latents"), sums, strict=True)


@cache
def law() -> Float64:
    """[BINS,SYMBOLS] the two-sided geometric law with a dead zone: P(0) = 1 - q^0.62 and magnitudes by powers of q."""
    q = np.linspace(1e-6, 1 - 1e-6, 100_001)
    expected = 2.0 ** ((np.arange(BINS) - UNIT_BIN) / 4)
    q = np.interp(expected, q**0.62 / (1 - q), q)[:, None]
    magnitude = (np.arange(SYMBOLS) + 1) // 2
    shares = np.where(magnitude == 0, 1 - q**0.62, q**0.62 * (1 - q) * q ** np.maximum(magnitude - 1, 0) / 2)
    shares[:, ESCAPE] = 1 - shares[:, :ESCAPE].sum(axis=1)
    return np.asarray(np.maximum(shares, 1e-9), np.float64)


def bits(counts: Float64, tables: Float64) -> float:
    """Code length of symbols, without what follows escapes."""
    return float(-(counts * np.log2(tables / tables.sum(axis=1, keepdims=True))).sum())


def learned(counts: Float64) -> Float64:
    """[BINS,SYMBOLS] shares of counts of equal signs, where few symbols occur mixed with the law."""
    both = counts.copy()
    both[:, 1:15:2] = both[:, 2:16:2] = (counts[:, 1:15:2] + counts[:, 2:16:2]) / 2
    both += _PRIOR * law()
    return np.asarray(both / both.sum(axis=1, keepdims=True), np.float64)


def fitted(counts: list[Float64]) -> Float64:
    """Shares [BINS,SYMBOLS] whose largest excess over each group's own tables is least.

    For given weights of the groups the best tables are their weighted counts; weights grow where the excess is large.
    """
    counts = [_WEIGHT * group / group.sum() for group in counts]
    own = [bits(group, learned(group)) for group in counts]
    weights, total = np.full(len(counts), 1 / len(counts)), np.zeros((BINS, SYMBOLS))
    for _ in range(_ROUNDS):
        tables = learned(sum((w * group for w, group in zip(weights, counts, strict=True)), np.zeros_like(total)))
        excess = np.array([bits(group, tables) / best for group, best in zip(counts, own, strict=True)])
        weights *= np.exp(2 * (excess - excess.max()))
        weights /= weights.sum()
        total += tables
    return total / _ROUNDS


def whole(shares: Float64) -> Int64:
    """Frequencies of sum 4096, none 0, of equal signs, with zero ever rarer from bin to bin."""
    tables = np.maximum(np.round(4096 * shares), 1).astype(np.int64)
    before = 4096
    for row in tables:
        row[0] += 4096 - row.sum()
        surplus = max(0, row[0] - (before - 2)) + 1 >> 1
        row[:3] += surplus * np.array([-2, 1, 1])
        before = int(row[0])
    return tables


def main() -> None:
    """Fit and judge."""
    files = [Path(argument) for argument in sys.argv[1:]]
    found = [(f"{path.stem}, {name}", counts) for path in files for name, counts in groups(path)]
    tables = whole(fitted([counts[0] for _, counts in found]))
    print("excess over tables of its own, on odd frames: new, version 1's")
    for name, (even, odd) in found:
        own, count = bits(odd, learned(even)), odd.sum()
        excess = [100 * (bits(odd, one.astype(np.float64)) / own - 1) for one in (tables, FREQUENCIES)]
        print(f"  {excess[0]:+5.2f} % {excess[1]:+5.2f} %  {name}: {count:.0f} symbols, {own / count:.3f} bit each")


if __name__ == "__main__":
    main()
