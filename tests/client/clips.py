"""Small recordings for the client's tests."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from tests.codec.scenes import make_scene, move

FRAME_NS = 33_333_333


def plain_scene(counts: tuple[int, ...] = (10, 40, 90), seed: int = 0) -> Scene:
    """A scene that looks the same from all views."""
    scene = make_scene(counts, seed)
    weights = scene.weights
    hidden = np.ascontiguousarray(weights.hidden_weight[: len(scene.header.feature_steps)])
    return replace(
        scene, header=replace(scene.header, view_dependent=False), weights=replace(weights, hidden_weight=hidden)
    )


def states(count: int, scene: Scene | None = None) -> list[Scene]:
    """A keyframe and `count - 1` moves from it."""
    found = [plain_scene() if scene is None else scene]
    while len(found) < count:
        found.append(move(found[-1]))
    return found


def packets(scenes: list[Scene]) -> list[bytes]:
    """One key packet, then predicted ones."""
    found = [encode_keyframe(scenes[0], time_ns=0, profile=0)]
    for before, after in itertools.pairwise(scenes):
        time_ns = after.version * FRAME_NS
        residual = difference(before, after)
        found.append(encode_residual(before, residual, time_ns=time_ns, profile=0))
    return found


def write_clip(path: Path, scenes: list[Scene]) -> list[bytes]:
    """The states as a `.slod` file; returns its packets."""
    found = packets(scenes)
    with SlodWriter(path) as writer:
        for packet in found:
            writer.append(packet)
    return found
