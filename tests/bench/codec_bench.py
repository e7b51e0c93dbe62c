"""What the bitstream costs: ``python -m tests.bench.codec_bench [FILE.slod]``; without a file, on made-up motion.

Prints sizes by part, distances to entropy bounds and to general compressors, and speeds. All sizes are of real bytes,
except the split of CHANGE chunks into set, positions and latents, which is the code length of the items (exact to a
byte a level). What a rate costs in quality needs training: `later_frames_bench --set rate_weight=...`.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from streamlod.codec.chunks.change import Elapsed, history
from streamlod.codec.coder import change_model
from streamlod.codec.coder.entropy import encode_scales, scale_of
from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import PacketInfo, peek
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.arrays import Float64
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.entropy_model import SCALES
from streamlod.core.scene.quantise import trailing_zeros
from streamlod.core.scene.residual import LevelResidual, Residual, difference
from tests.bench.codec_bounds import item_bits, latents_bits, latents_report
from tests.bench.codec_timing import javascript_speed, python_speed
from tests.codec.scenes import make_scene, steps


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """States of one keyframe's life, the residuals between them, and their packets."""

    states: list[Scene]
    residuals: list[Residual]
    packets: list[bytes]


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
    return _clip(states)


def invent(frames: int = 12) -> Clip:
    """A made-up clip of 40 000 anchors."""
    return _clip(steps(make_scene((1800, 6000, 13000, 18000, 21000)), frames)[0])


def _clip(states: list[Scene]) -> Clip:
    residuals = [difference(a, b) for a, b in pairwise(states)]
    packets = [_predicted(a, r) for a, r in zip(states, residuals, strict=False)]
    return Clip(states, residuals, packets)


def _predicted(before: Scene, residual: Residual, profile: int = 1) -> bytes:
    return encode_residual(before, residual, time_ns=0, profile=profile)


def keyframe_report(scene: Scene) -> None:
    """Size of the keyframe."""
    packet = encode_keyframe(scene, time_ns=0)
    info, count = peek(packet), max(scene.anchor_count, 1)
    print(f"keyframe: {scene.anchor_count} anchors {[len(level) for level in scene.levels]}, {len(packet)} B,", end=" ")
    print(f"{8 * len(packet) / count:.1f} bit/anchor; profile 0: {len(encode_keyframe(scene, time_ns=0, profile=0))} B")
    print("  " + ", ".join(f"{name} {8 * size / count:.1f} bit/anchor" for name, size in info.chunk_bytes.items()))
    groups = {name: _column_entropy(scene, name) / count for name in ("feature", "offset", "scaling", "extra_level")}
    print("  order-0 entropy: " + ", ".join(f"{name} {bits:.1f} bit/anchor" for name, bits in groups.items()))
    shares = [100 * size / len(packet) for size in info.level_bytes]
    print(f"  levels {info.level_bytes}; levels 0-2: {sum(shares[:3]):.0f} %, level 0: {shares[0]:.0f} %")
    print("  rows by precision: " + ", ".join(f"{100 * share:.1f} %" for share in _precisions(scene)))


def _precisions(scene: Scene) -> Float64:
    """[8] share of the anchors whose numbers are multiples of 2^k of the finest quantum."""
    shifts = [
        trailing_zeros(np.concatenate([level.feature, level.offset, level.scaling], axis=1), 7)
        for level in scene.levels
    ]
    return np.bincount(np.concatenate(shifts), minlength=8) / max(scene.anchor_count, 1)


def _column_entropy(scene: Scene, name: str) -> float:
    bits = 0.0
    for level in scene.levels:
        for column in getattr(level, name).reshape(len(level), -1).T if len(level) else ():
            _, counts = np.unique(column, return_counts=True)
            bits -= float((counts * np.log2(counts / len(level))).sum())
    return bits


def _split(level: LevelResidual, before: AnchorLevel, elapsed: Elapsed) -> Float64:
    """Bits of the dynamic set, the positions and the latents of one level."""
    items, changed = np.empty(200 + 20 * (len(before) + 30 * len(level.rows)), np.uint32), np.zeros(len(before), "u1")
    changed[level.rows] = 1
    position, latent = level.position.astype(np.int64), level.latent.astype(np.int64)
    motion = change_model.steady_motion(before.position, level.rows, elapsed.age, elapsed.span)
    errors = change_model.position_errors(position, motion)
    scale = int(SCALES[scale_of(float(np.abs(errors).mean()) if len(errors) else 0)])
    touched = history(before)
    ends = [0, change_model.rows_items(changed, touched, items, 0)]
    ends.append(change_model.positions_items(errors, motion, scale, items, ends[-1]))
    latent_scale = encode_scales(latent[latent.any(axis=1)])[1]
    ends.append(change_model.latents_items(latent, before.latent[level.rows], latent_scale, items, ends[-1]))
    return np.array([item_bits(items[a:b].astype(np.int64)) for a, b in pairwise(ends)])


def predicted_report(clip: Clip) -> None:
    """Size of predicted packets, and where it goes."""
    sizes = np.array([len(packet) for packet in clip.packets])
    counts = np.array([sum(len(level.rows) for level in r.levels) for r in clip.residuals])
    anchors = np.mean([scene.anchor_count for scene in clip.states])
    zeros = np.mean(np.concatenate([level.latent for r in clip.residuals for level in r.levels]) == 0)
    parts = np.zeros(3)
    for state, residual in zip(clip.states, clip.residuals, strict=False):
        elapsed = Elapsed(state.version - state.keyframe, residual.to_version - state.version)
        for before, level in zip(state.levels, residual.levels, strict=True):
            if len(level.rows):
                parts += _split(level, before, elapsed)
    total, dynamic = 8.0 * sizes.sum(), max(int(counts.sum()), 1)
    plain = [len(_predicted(a, r, 0)) for a, r in zip(clip.states, clip.residuals, strict=False)]
    print(f"predicted: {len(sizes)} packets, mean {sizes.mean():.0f} B, largest {sizes.max()} B,", end=" ")
    print(f"{counts.mean():.0f} dynamic of {anchors:.0f} anchors, {100 * zeros:.0f} % zero latents")
    names = ("set", "position", "latents")
    print(f"  {total / dynamic:.1f} bit per dynamic anchor:", end=" ")
    print(", ".join(f"{n} {p / dynamic:.1f}" for n, p in zip(names, parts, strict=True)), end=", ")
    print(f"all else {(total - parts.sum()) / dynamic:.1f}; profile 0: {np.mean(plain):.0f} B")
    _growth_report(sizes.astype(np.float64), counts / anchors)
    infos = [peek(packet) for packet in clip.packets]
    outside = np.array([info.size_bytes - sum(info.level_bytes) for info in infos], np.float64)
    print(f"  header and directory {outside.mean():.0f} B: {100 * outside.mean() / 20_000:.2f} % of a 20 KB packet")
    print("  bytes a packet: " + ", ".join(f"{name} {size:.0f}" for name, size in _by_kind(infos).items()))
    state = replace(clip.states[0], version=clip.states[0].version + 1)  # the first after a keyframe carries hashes
    still = _predicted(state, difference(state, replace(state, version=state.version + 1)))
    print(f"  a still frame: {len(still)} B")


def _growth_report(sizes: Float64, shares: Float64) -> None:
    """How packets grow with the share of anchors that change."""
    if len(sizes) < 3 or np.ptp(shares) == 0:
        return
    slope, base = np.polyfit(100 * shares, sizes, 1)
    print(f"  dynamic share {100 * shares.min():.1f} to {100 * shares.max():.1f} %:", end=" ")
    print(f"about {base:.0f} B and {slope:.0f} B for each per cent of anchors")


def _by_kind(infos: list[PacketInfo]) -> dict[str, float]:
    sizes: dict[str, float] = {}
    for info in infos:
        for name, size in info.chunk_bytes.items():
            sizes[name] = sizes.get(name, 0) + size / len(infos)
    return sizes


def reach_report(clip: Clip) -> None:
    """Skip and catch-up packets against the chain that they replace."""
    sizes = np.cumsum([0] + [len(packet) for packet in clip.packets])
    for reach in (2, 4, 8, 16, len(clip.states) - 1):
        if reach < len(clip.states):
            a, b = clip.states[-1 - reach], clip.states[-1]
            size = len(encode_residual(a, difference(a, b), time_ns=0))
            chain = sizes[-1] - sizes[-1 - reach]
            print(f"skip over {reach} frames: {size} B, {100 * size / chain:.0f} % of the chain's {chain} B")


def joint_report(clip: Clip) -> None:
    """What independent levels cost against one level that holds everything, in latents."""
    apart = joint = 0.0
    for state, residual in zip(clip.states, clip.residuals, strict=False):
        parts = [
            (level.latent.astype(np.int64), before.latent[level.rows])
            for before, level in zip(state.levels, residual.levels, strict=True)
            if len(level.rows)
        ]
        if parts:
            apart += sum(latents_bits(*part)[0] + 16 for part in parts)
            joint += latents_bits(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))[0] + 64
    print(f"levels coded apart: latents {100 * (apart / max(joint, 1) - 1):+.1f} % against joint coding")


def container_report(clip: Clip) -> None:
    """What a file adds to its packets."""
    key = encode_keyframe(clip.states[0], time_ns=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip.slod"
        with SlodWriter(path) as writer:
            for packet in (key, *clip.packets):
                writer.append(packet)
        more = path.stat().st_size - len(key) - sum(map(len, clip.packets))
        print(f"file: {more / (1 + len(clip.packets)):.0f} B a packet beside the packet itself")
        javascript_speed(path)


def main() -> None:
    """Print everything."""
    clip = load(Path(sys.argv[1])) if len(sys.argv) > 1 else invent()
    keyframe_report(clip.states[0])
    predicted_report(clip)
    latents_report(clip.states, clip.residuals)
    joint_report(clip)
    reach_report(clip)
    python_speed(clip.states, clip.residuals)
    container_report(clip)


if __name__ == "__main__":
    main()
