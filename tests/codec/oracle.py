"""The entropy coder in plain, slow Python: the reference of `codec.coder.rans` and its models, and of other decoders.

Every model below runs in both directions: `Decoder` reads values from words; `Encoder` is given the values and lists
items. So the two directions cannot differ here, and the compiled code is tested against both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from streamlod.core.errors import BitstreamError
from streamlod.core.scene.entropy_model import BIN_THRESHOLDS, BINS, ESCAPE, FREQUENCIES, HALVED_FROM

_THRESHOLDS = [int(t) for t in BIN_THRESHOLDS]
_ROWS = [[int(f) for f in row] for row in FREQUENCIES]
_MIN_STATE = 1 << 16
Rows = list[list[int]]
Voxel = tuple[int, int, int]


class Coder(Protocol):
    """An item coder: `encode` gives start and frequency of `symbol`; the decoder finds the symbol itself."""

    def interval(self, frequencies: Sequence[int], symbol: int | None) -> int:
        """Code one symbol of frequencies that sum to 4096; returns it."""


class Encoder:
    """Lists items; `words` codes them backwards."""

    def __init__(self) -> None:
        self._items: list[tuple[int, int]] = []

    def interval(self, frequencies: Sequence[int], symbol: int | None) -> int:
        """Note the symbol."""
        if symbol is None:
            raise ValueError("an encoder must be told what to encode")
        self._items.append((sum(frequencies[:symbol]), frequencies[symbol]))
        return symbol

    def words(self, lanes: int) -> list[int]:
        """The 16-bit words of all items so far."""
        states, backwards = [_MIN_STATE] * lanes, []
        for number in reversed(range(len(self._items))):
            start, freq = self._items[number]
            state = states[number % lanes]
            if state >= freq << 20:
                backwards.append(state & 0xFFFF)
                state >>= 16
            states[number % lanes] = (state // freq << 12) + state % freq + start
        head = [half for state in states for half in (state & 0xFFFF, state >> 16)]
        return head + backwards[::-1]


class Decoder:
    """Reads items from words."""

    def __init__(self, words: Sequence[int], lanes: int) -> None:
        if len(words) < 2 * lanes:
            raise _corrupt()
        self._states = [words[2 * k] | words[2 * k + 1] << 16 for k in range(lanes)]
        self._words, self._at, self._item = words, 2 * lanes, 0
        if min(self._states) < _MIN_STATE:
            raise _corrupt()

    def interval(self, frequencies: Sequence[int], symbol: int | None = None) -> int:
        """Read a symbol."""
        lane = self._item % len(self._states)
        self._item += 1
        slot, start, symbol = self._states[lane] & 4095, 0, 0
        while start + frequencies[symbol] <= slot:
            start += frequencies[symbol]
            symbol += 1
        state = frequencies[symbol] * (self._states[lane] >> 12) + slot - start
        if state < _MIN_STATE:
            if self._at == len(self._words):
                raise _corrupt()
            state = state << 16 | self._words[self._at]
            self._at += 1
        self._states[lane] = state
        return symbol

    def finish(self) -> None:
        """Refuse a stream that did not end as it must."""
        if self._at != len(self._words) or any(state != _MIN_STATE for state in self._states):
            raise _corrupt()


def raw(coder: Coder, width: int, value: int | None) -> int:
    """`width` bits, in groups of 12, lowest first."""
    result, shift = 0, 0
    while width > 0:
        group = min(width, 12)
        part = None if value is None else value >> shift & ((1 << group) - 1)
        result |= coder.interval([1 << 12 - group] * (1 << group), part) << shift
        shift, width = shift + group, width - group
    return result


def flag(coder: Coder, model: list[int], bit: int | None) -> int:
    """One bit under an adaptive model of two counters."""
    split = min(max(4096 * model[0] // sum(model), 1), 4095)
    bit = coder.interval([split, 4096 - split], bit)
    model[bit] += 2
    if sum(model) > 1020:
        model[:] = [(count + 1) >> 1 for count in model]
    return bit


def magnitude_bin(e: int) -> int:
    """bin(e)."""
    k = 0
    while e >= HALVED_FROM:
        e, k = e >> 1, k + 4
    return k + sum(threshold <= e for threshold in _THRESHOLDS)


def value(coder: Coder, b: int, number: int | None) -> int:
    """A signed integer by the frozen table of bin b."""
    b, shift = min(max(b, 0), 120), 0
    if b >= BINS:
        shift = (b - BINS + 4) >> 2
        b -= 4 * shift
    half = (1 << shift) >> 1
    z = None
    if number is not None:
        high = (number + half) >> shift
        z = 2 * high if high >= 0 else -2 * high - 1
    symbol = coder.interval(_ROWS[b], None if z is None else min(z, ESCAPE))
    if symbol == ESCAPE:
        rest = None if z is None else z - ESCAPE + 1
        width = 0
        while raw(coder, 1, None if rest is None else int(rest >> width + 1 > 0)):
            width += 1
            if width > 30:
                raise _corrupt()
        symbol = ESCAPE - 1 + (1 << width) + raw(coder, width, None if rest is None else rest - (1 << width))
    high = symbol // 2 if symbol % 2 == 0 else -(symbol + 1) // 2
    low = raw(coder, shift, None if number is None else number + half - (high << shift))
    result = (high << shift) - half + low
    if abs(result) >= 1 << 30:
        raise _corrupt()
    return result


def columns(coder: Coder, rows: int, scale: Sequence[int], numbers: Rows | None) -> Rows:
    """Rows of integers with energy context, FORMAT.md section 6.3."""
    weight = [65536 // (256 + m) if m else 0 for m in scale]
    expected = [max(1, (w * m + 128) >> 8) if m else 0 for w, m in zip(weight, scale, strict=True)]
    total = sum(expected)
    mean, result = total, []
    for i in range(rows):
        energy, seen, gain, row = 0, 0, 0, []
        for c, m in enumerate(scale):
            if total and c % 2 == 0:
                gain = magnitude_bin(256 * (mean + 2 * energy) // (total + 2 * seen)) - 24
            number = 0
            if m:
                b = magnitude_bin(m) + gain
                number = value(coder, b, None if numbers is None else numbers[i][c])
            energy += weight[c] * min(abs(number), 65535)
            seen += expected[c]
            row.append(number)
        mean += (energy - mean) >> 3
        result.append(row)
    return result


def classes(coder: Coder, rows: int, count: int, wanted: Sequence[int] | None) -> list[int]:
    """Which of `count` classes each row is of, FORMAT.md section 6.4."""
    models = [[1, 1] for _ in range(count)]
    result: list[int] = []
    for i in range(rows):
        own = count - 1
        for k in range(count - 1):
            if flag(coder, models[k], None if wanted is None else int(wanted[i] == k)):
                own = k
                break
        result.append(own)
    return result


def classed_columns(
    coder: Coder, rows: int, scales: Sequence[Sequence[int]], wanted: tuple[list[int], Rows] | None
) -> Rows:
    """Rows of integers, each class coded apart, FORMAT.md section 6.4; `wanted` are classes and numbers."""
    of_row = classes(coder, rows, len(scales), None if wanted is None else wanted[0])
    result: Rows = [[] for _ in range(rows)]
    for k, scale in enumerate(scales):
        own = [i for i in range(rows) if of_row[i] == k]
        numbers = None if wanted is None else [wanted[1][i] for i in own]
        for i, row in zip(own, columns(coder, len(own), scale, numbers), strict=True):
            result[i] = row
    return result


def trend(numbers: Sequence[int], shifts: Sequence[int]) -> list[int]:
    """A channel of mode 2 from what 6.4 gives, each number in 2^shift, FORMAT.md section 8."""
    total, result = 0, []
    for number, shift in zip(numbers, shifts, strict=True):
        half = (1 << shift) >> 1
        result.append((number + ((total >> 3) + half >> shift)) * 2**shift)
        total += result[-1] - (total >> 3)
    return result


def dynamic_set(coder: Coder, touched: Sequence[int], changed: Sequence[int] | None) -> list[int]:
    """Which rows change, as 0 and 1, where `touched` says which ones have before, FORMAT.md section 9."""
    blocks, models = [[1, 1] for _ in range(8)], [[1, 1] for _ in range(16)]
    used, before, bits = 0, 0, [0, 0, 0]
    result: list[int] = []
    for first in range(0, len(touched), 64):
        rows = range(first, min(first + 64, len(touched)))
        wanted = None if changed is None else int(any(changed[i] for i in rows))
        model = blocks[4 * max(touched[i] for i in rows) + 2 * used + before]
        used, before = flag(coder, model, wanted), used
        for i in rows:
            a3, a2, a1 = bits[-3:]
            model = models[8 * touched[i] + 4 * a1 + 2 * a2 + a3]
            bit = flag(coder, model, None if changed is None else changed[i]) if used else 0
            bits.append(bit)
            result.append(bit)
    return result


def latents(coder: Coder, before: Rows, scale: Sequence[int], numbers: Rows | None) -> Rows:
    """Latent differences of the changed rows, which had latents `before`, FORMAT.md section 9."""
    models = [[1, 1] for _ in range(2)]
    flags: list[int] = []
    for i, past in enumerate(before):
        wanted = None if numbers is None else int(any(numbers[i]))
        flags.append(flag(coder, models[int(any(past))], wanted))
    chosen = [i for i, own in enumerate(flags) if own]
    found = columns(coder, len(chosen), scale, numbers and [numbers[i] for i in chosen])
    result: Rows = [[0] * len(scale) for _ in before]
    for i, row in zip(chosen, found, strict=True):
        result[i] = row
    return result


def steady_motion(positions: Rows, age: int, span: int) -> Rows:
    """Motion in `span` frames at the mean speed of `age` frames, in 1/128 step, FORMAT.md section 9."""
    return [[128 * p * min(span, age, 255) // age if age else 0 for p in row] for row in positions]


def positions(coder: Coder, motion: Rows, scale: int, delta: Rows | None) -> Rows:
    """Position differences of the changed rows whose steady motion is `motion`, FORMAT.md section 9."""
    average, before, mean = [scale] * 3, 3 * scale, 3 * scale
    trend, result = [0] * 3, []
    for i, steady in enumerate(motion):
        within, row = 0, []
        for axis in range(3):
            prediction = (steady[axis] + trend[axis] + 128) // 256
            e = 4 * average[axis] + before + 3 * mean + 6 * within + 4 * sum(map(abs, steady))
            b = magnitude_bin(e // (18 + 6 * axis))
            error = value(coder, b, None if delta is None else delta[i][axis] - prediction)
            if abs(prediction + error) >= 1 << 31:
                raise _corrupt()
            row.append(prediction + error)
            average[axis] += (256 * abs(error) - average[axis]) >> 6
            trend[axis] += 16 * row[axis] - (trend[axis] >> 2)
            within += 256 * abs(error)
        before, mean = within, mean + ((within - mean) >> 3)
        result.append(row)
    return result


def octree(coder: Coder, depth: int, count: int, leaves: Sequence[Voxel] | None) -> list[Voxel]:
    """`count` leaves of an octree of `depth`, in Morton order, FORMAT.md section 7."""
    models: dict[tuple[int, int, int], list[int]] = {}
    nodes: list[tuple[Voxel, int]] = [((0, 0, 0), 0)]
    for d in range(depth):
        there = None
        if leaves is not None:
            there = {(x >> depth - 1 - d, y >> depth - 1 - d, z >> depth - 1 - d) for x, y, z in leaves}
        following: list[tuple[Voxel, int]] = []
        for (x, y, z), parent in nodes:
            prefix, born = 1, []
            for j in range(8):
                child = (2 * x + (j >> 2), 2 * y + (j >> 1 & 1), 2 * z + (j & 1))
                bit = 1
                if j < 7 or prefix != 1 << 7:
                    model = models.setdefault((min(depth - 1 - d, 3), parent, prefix), [1, 1])
                    bit = flag(coder, model, None if there is None else int(child in there))
                prefix = 2 * prefix + bit
                born += [child] * bit
            following += [(child, (0, 0, 1, 2, 2, 3, 3, 3, 3)[len(born)]) for child in born]
            if len(following) > count:
                raise _corrupt()
        nodes = following
    if len(nodes) != count:
        raise _corrupt()
    return [node for node, _ in nodes]


def _corrupt() -> BitstreamError:
    return BitstreamError("corrupt_chunk", "the entropy-coded words are not sound")
