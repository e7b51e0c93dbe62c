"""What the bitstream costs: ``python -m tests.bench.codec_bench [FILE.slod]``; without a file, on made-up motion.

Prints sizes by part, distances to entropy bounds and to general compressors, and speeds. All sizes are of real bytes,
except the split of CHANGE chunks into set, positions and latents, which is the code length of the items (exact to a
byte a level).
"""

from __future__ import annotations

import lzma
import sys
import time
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from codec import change_model, column_model, rans
from codec.change import touched
from codec.compiled import compiled
from codec.container import SlodReader
from codec.decoder import SceneDecoder
from codec.encoder import encode_keyframe, encode_residual
from codec.entropy import encode_scales, scale_of
from codec.packet import PacketKind, peek
from core.anchors import LATENTS, AnchorLevel, Scene
from core.arrays import Float64, Int64
from core.entropy_model import BINS, SCALES
from core.residual import LevelResidual, Residual, difference
from tests.codec.scenes import make_scene, steps

SYMBOLS_PER_ROW = LATENTS + 3
LZMA = [{"id": lzma.FILTER_LZMA1, "preset": 9, "lc": 0}]


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """States of one keyframe's life, and the residuals between them."""

    states: list[Scene]
    residuals: list[Residual]


def load(path: Path) -> Clip:
    """The first keyframe of a file and what follows it."""
    decoder, states = SceneDecoder(), list[Scene]()
    with SlodReader(path) as reader:
        for packet in reader.packets():
            if peek(packet).kind is PacketKind.KEY and states and peek(packet).keyframe != states[0].keyframe:
                break
            decoder.push(packet)
            if decoder.scene is not None and (not states or decoder.scene.version > states[-1].version):
                states.append(decoder.scene)
            elif decoder.scene is not None:
                states[-1] = decoder.scene  # a further part of the same frame
    return Clip(states, [difference(a, b) for a, b in pairwise(states)])


def invent(frames: int = 12) -> Clip:
    """A made-up clip of 40 000 anchors."""
    return Clip(*steps(make_scene((1800, 6000, 13000, 18000, 21000)), frames))


def keyframe_report(scene: Scene) -> None:
    """Size of the keyframe."""
    packet = encode_keyframe(scene, time_ns=0)
    info, count = peek(packet), max(scene.anchor_count, 1)
    print(f"keyframe: {scene.anchor_count} anchors {[len(level) for level in scene.levels]}, {len(packet)} B,", end=" ")
    print(f"{8 * len(packet) / count:.1f} bit/anchor; profile 0: {len(encode_keyframe(scene, time_ns=0, profile=0))} B")
    print("  " + ", ".join(f"{name} {8 * size / count:.1f} bit/anchor" for name, size in info.chunk_bytes.items()))
    print(f"  levels {info.level_bytes}; levels 0-2: {100 * sum(info.level_bytes[:3]) / len(packet):.0f} %")


def _item_bits(items: Int64) -> float:
    return float(-np.log2((items & 0xFFFF) / 4096).sum())


def _split(level: LevelResidual, before: AnchorLevel) -> Float64:
    """Bits of the dynamic set, the positions and the latents of one level."""
    rows, voxel = len(before), before.voxel.astype(np.int64)
    items, changed = np.empty(200 + 20 * (rows + 30 * len(level.rows)), np.uint32), np.zeros(rows, np.uint8)
    changed[level.rows] = 1
    position, latent = level.position.astype(np.int64), level.latent.astype(np.int64)
    errors = change_model.position_errors(voxel[level.rows], position, np.uint64(1))
    errors = min(errors, position, key=lambda values: float(np.log2(1.0 + np.abs(values)).sum()))
    scale = int(SCALES[scale_of(float(np.abs(errors).mean()) if len(errors) else 0)])
    ends = [0, change_model.rows_items(changed, touched(before), items, 0)]
    ends.append(change_model.positions_items(errors, scale, items, ends[-1]))
    ends.append(column_model.columns_items(latent, encode_scales(latent)[1], items, ends[-1]))
    return np.array([_item_bits(items[a:b].astype(np.int64)) for a, b in pairwise(ends)])


def predicted_report(clip: Clip) -> None:
    """Size of predicted packets, and where it goes."""
    packets = [
        encode_residual(a, r, kind=PacketKind.PREDICTED, time_ns=0)
        for a, r in zip(clip.states, clip.residuals, strict=False)
    ]
    plain = [
        encode_residual(a, r, kind=PacketKind.PREDICTED, time_ns=0, profile=0)
        for a, r in zip(clip.states, clip.residuals, strict=False)
    ]
    sizes = np.array([len(p) for p in packets])
    dynamic = sum(len(level.rows) for r in clip.residuals for level in r.levels)
    anchors = np.mean([scene.anchor_count for scene in clip.states])
    zeros = np.mean(np.concatenate([_latents(r) for r in clip.residuals]) == 0)
    parts = np.zeros(3)
    for state, residual in zip(clip.states, clip.residuals, strict=False):
        for before, level in zip(state.levels, residual.levels, strict=True):
            if len(level.rows):
                parts += _split(level, before)
    total = 8.0 * sizes.sum()
    print(f"predicted: {len(sizes)} packets, mean {sizes.mean():.0f} B, largest {sizes.max()} B,", end=" ")
    print(f"{dynamic / len(sizes):.0f} dynamic of {anchors:.0f} anchors, {100 * zeros:.0f} % zero latents")
    print(f"  {total / max(dynamic, 1):.1f} bit per dynamic anchor:", end=" ")
    names = ("set", "position", "latents")
    print(", ".join(f"{n} {p / max(dynamic, 1):.1f}" for n, p in zip(names, parts, strict=True)), end=", ")
    print(
        f"all else {(total - parts.sum()) / max(dynamic, 1):.1f}; profile 0: {np.mean([len(p) for p in plain]):.0f} B"
    )
    by_kind: dict[str, float] = {}
    for packet in packets:
        for name, size in peek(packet).chunk_bytes.items():
            by_kind[name] = by_kind.get(name, 0) + size / len(packets)
    print("  bytes a packet: " + ", ".join(f"{name} {size:.0f}" for name, size in by_kind.items()))


def _latents(residual: Residual) -> Int64:
    return np.concatenate([level.latent for level in residual.levels]).astype(np.int64)


@compiled
def _context_bins(values: Int64, scale: Int64, bins_out: Int64) -> None:
    """The bin under which each latent is coded, -1 for uncoded channels."""
    bins, weight, expected, total = column_model.channel_weights(scale)
    mean = total
    for i in range(len(values)):
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if column_model.renews(c) and total:
                gain = column_model.row_gain(mean, total, energy, seen)
            bins_out[i, c] = max(bins[c] + gain, 0) if scale[c] else -1
            energy += weight[c] * min(abs(values[i, c]), 65535)
            seen += expected[c]
        mean += (energy - mean) >> 3


def _entropy(counts: Float64) -> float:
    """Bits of all symbols at their empirical frequencies, a row a distribution."""
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return float(-(counts * np.log2(np.where(counts > 0, share, 1))).sum())


def latents_report(clip: Clip) -> None:
    """Latents alone: our bits, entropy bounds, general compressors."""
    ours = general = count = 0.0
    deflated = packed = 0
    histogram = np.zeros((LATENTS, 129))
    by_bin = np.zeros((2, BINS + 1, 129))
    for frame, residual in enumerate(clip.residuals):
        for level in residual.levels:
            latent = np.clip(level.latent.astype(np.int64), -64, 64)
            if len(latent) == 0:
                continue
            side, scale = encode_scales(latent)
            items = np.empty(200 + 400 * len(latent), np.uint32)
            ours += _item_bits(items[: column_model.columns_items(latent, scale, items, 0)].astype(np.int64)) + 8 * len(
                side
            )
            bins = np.empty_like(latent)
            _context_bins(latent, scale, bins)
            np.add.at(by_bin[frame % 2], (np.minimum(bins, BINS - 1), latent + 64), 1)
            for channel in range(LATENTS):
                histogram[channel] += np.bincount(latent[:, channel] + 64, minlength=129)
            count += latent.size
            bytes_ = latent.astype(np.int8).T.tobytes()
            deflated += len(zlib.compress(bytes_, 9))
            packed += min(
                len(lzma.compress(bytes_, lzma.FORMAT_RAW, filters=[{"id": lzma.FILTER_LZMA1, "preset": 9, "lc": 0}])),
                10**9,
            )
            general += len(_zstd(bytes_))
    held_out = 0.0
    for train, test in ((0, 1), (1, 0)):
        smooth = by_bin[train] + 0.02 * by_bin[train].sum(axis=0) / max(count, 1) + 1e-3
        held_out += float(-(by_bin[test] * np.log2(smooth / smooth.sum(axis=1, keepdims=True))).sum())
    rows = (
        ("ours, side fields included", ours),
        ("order-0 a channel, no side information", _entropy(histogram)),
        ("tables learned on other frames, same contexts", held_out + 0.0),
        ("zstd -19, a level and frame", 8.0 * general),
        ("lzma -9e", 8.0 * packed),
        ("deflate -9", 8.0 * deflated),
    )
    print(f"latents: {count / len(clip.residuals):.0f} symbols a frame")
    for name, bits in rows:
        print(f"  {bits / max(count, 1):.4f} bit/symbol, {100 * (bits / ours - 1):+6.1f} %  {name}")


def _zstd(data: bytes) -> bytes:
    try:
        import zstandard  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        return data
    return bytes(zstandard.ZstdCompressor(level=19).compress(data))


def reach_report(clip: Clip) -> None:
    """Skip and catch-up packets against the chain that they replace."""
    sizes = [0]
    for a, r in zip(clip.states, clip.residuals, strict=False):
        sizes.append(sizes[-1] + len(encode_residual(a, r, kind=PacketKind.PREDICTED, time_ns=0)))
    first = clip.states[0].version
    for reach in (2, 4, 8, 16, 29):
        if reach < len(clip.states):
            a, b = clip.states[-1 - reach], clip.states[-1]
            kind = PacketKind.CATCH_UP if a.version == first else PacketKind.SKIP
            size = len(encode_residual(a, difference(a, b), kind=kind, time_ns=0))
            chain = sizes[-1] - sizes[-1 - reach]
            print(f"skip over {reach} frames: {size} B, {100 * size / chain:.0f} % of the chain's {chain} B")


def joint_report(clip: Clip) -> None:
    """What independent levels cost against one level that holds everything, latents and positions."""
    apart = joint = 0.0
    for state, residual in zip(clip.states, clip.residuals, strict=False):
        every = [
            (before.voxel, level)
            for before, level in zip(state.levels, residual.levels, strict=True)
            if len(level.rows)
        ]
        if not every:
            continue
        latents = [level.latent.astype(np.int64) for _, level in every]
        apart += sum(_columns_bits(latent) + 16 for latent in latents)
        joint += _columns_bits(np.concatenate(latents)) + 64
    print(f"levels coded apart: latents {100 * (apart / max(joint, 1) - 1):+.1f} % against joint coding")


def _columns_bits(values: Int64) -> float:
    side, scale = encode_scales(values)
    items = np.empty(200 + 20 * values.size, np.uint32)
    return _item_bits(items[: column_model.columns_items(values, scale, items, 0)].astype(np.int64)) + 8 * len(side)


def speed_report(clip: Clip) -> None:
    """Milliseconds and symbols a second, medians over the clip; the first pass compiles."""
    key = encode_keyframe(clip.states[0], time_ns=0)
    for _ in range(2):
        encoding, decoding, symbols = list[float](), list[float](), list[int]()
        decoder = SceneDecoder()
        decoder.push(key)
        for a, r in zip(clip.states, clip.residuals, strict=False):
            begin = time.perf_counter()
            packet = encode_residual(a, r, kind=PacketKind.PREDICTED, time_ns=0)
            middle = time.perf_counter()
            decoder.push(packet)
            encoding.append(middle - begin)
            decoding.append(time.perf_counter() - middle)
            symbols.append(SYMBOLS_PER_ROW * sum(len(level.rows) for level in r.levels))
    count = float(np.median(symbols))
    for name, times in (("encode_residual", encoding), ("SceneDecoder.push", decoding)):
        seconds = float(np.median(times))
        print(
            f"{name}: {1e3 * seconds:.2f} ms a frame, {count / seconds / 1e6:.1f} Msymbol/s with everything around it"
        )
    values = np.concatenate([_latents(r) for r in clip.residuals])
    _, scale = encode_scales(values)
    items, words, found = np.empty(200 + 8 * values.size, np.uint32), np.empty(0, np.uint16), np.zeros_like(values)
    for _ in range(2):
        begin = time.perf_counter()
        n = column_model.columns_items(values, scale, items, 0)
        words = np.empty(n + 8, np.uint16)
        first = rans.rans_encode(items, n, 4, words)
        middle = time.perf_counter()
        column_model.decode_columns(words[first:], 4, found, scale)
        end = time.perf_counter()
    print(f"entropy coder alone: encode {values.size / (middle - begin) / 1e6:.0f}, ", end="")
    print(f"decode {values.size / (end - middle) / 1e6:.0f} Msymbol/s")


def main() -> None:
    """Print everything."""
    clip = load(Path(sys.argv[1])) if len(sys.argv) > 1 else invent()
    keyframe_report(clip.states[0])
    predicted_report(clip)
    latents_report(clip)
    joint_report(clip)
    reach_report(clip)
    speed_report(clip)


if __name__ == "__main__":
    main()
