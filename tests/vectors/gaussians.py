"""Vectors of codec/FORMAT.md section 14: the Gaussians of a few states, worked out from the document in float64.

`python -m tests.vectors.gaussians` writes gaussians.json. Nothing here comes from the code that it is compared with.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.codec.decoder import SceneDecoder
from streamlod.core.scene.anchors import Scene
from tests.vectors.make import FOLDER, read_stream

PATH = FOLDER / "gaussians.json"
VIEWS = (  # stream, eye, whether level selection is on
    ("valid-chain-profile0", (0.3, -0.2, -2.0), False),
    ("valid-rows-that-die-profile1", (4.0, 1.0, 0.5), False),
    ("valid-no-cameras-no-view", (0.0, 0.0, 0.0), False),
    ("valid-steady-motion", (-1.0, 2.0, 3.0), False),
    ("valid-chain-profile0", (9.0, 3.0, -8.0), True),
)
MOST_ROWS = 12  # of each level
TOLERANCE = {"mean": 1e-5, "scale": 1e-5, "rotation": 1e-4, "opacity": 1e-5, "colour": 1e-5}
Numbers = NDArray[np.float64]


def gaussians(scene: Scene, eye: Numbers, by_distance: bool) -> list[list[Any]]:
    """Level, row, slot, mean, scale, rotation of length 1, opacity and colour of each Gaussian that exists."""
    found = []
    for number, level in enumerate(scene.levels):
        for row in range(min(len(level), MOST_ROWS)):
            anchor = _anchor(scene, number, row)
            if level.alive[row] and (not by_distance or _drawn(scene, number, row, anchor, eye)):
                found += [[number, row, *values] for values in _slots(scene, number, row, anchor, eye)]
    return found


def _anchor(scene: Scene, number: int, row: int) -> Numbers:
    header, level = scene.header, scene.levels[number]
    node = header.octree.origin + level.voxel[row].astype(np.float64) * header.octree.root_cell / 2.0**number
    return np.asarray(node + level.position[row] * np.float64(header.position_steps[number]), np.float64)


def _drawn(scene: Scene, number: int, row: int, anchor: Numbers, eye: Numbers) -> bool:
    distance = float(np.linalg.norm(anchor - eye))
    wanted = math.log2(scene.header.reference_distance / distance) + scene.levels[number].extra_level[row] / 64
    assert abs(wanted % 1 - 0.5) > 1e-4, "on the boundary between two levels"
    return bool(min(max(round(wanted), 0), len(scene.levels) - 1) >= number)


def _slots(scene: Scene, number: int, row: int, anchor: Numbers, eye: Numbers) -> list[list[Any]]:
    header, level = scene.header, scene.levels[number]
    weights = {name: getattr(scene.weights, name).astype(np.float64) for name in scene.weights.__slots__}
    latent = level.latent[row].astype(np.float64)
    feature = level.feature[row] * header.feature_steps.astype(np.float64) + latent[:12] @ weights["feature_decoder"]
    offset = level.offset[row] * header.offset_steps.astype(np.float64) + latent[12:] @ weights["offset_decoder"]
    scaling = np.clip(level.scaling[row] * header.scaling_steps.astype(np.float64), -20, 20)
    inputs = feature
    if header.view_dependent:
        away = anchor - eye
        distance = max(float(np.linalg.norm(away)), 1e-12)
        inputs = np.array([*feature, *(away / distance), distance / header.reference_distance])
    hidden = np.maximum(inputs @ weights["hidden_weight"] + weights["hidden_bias"], 0)
    out, slots = hidden @ weights["output_weight"] + weights["output_bias"], header.gaussians_per_anchor
    found = []
    for k in range(slots):
        opacity = math.tanh(out[k])
        assert abs(opacity) > 1e-4, "neither there nor not"
        if opacity < 0:
            continue
        colour = _sigmoid(out[slots + 3 * k : slots + 3 * k + 3])
        scale = np.exp(scaling[3:]) * _sigmoid(out[4 * slots + 3 * k : 4 * slots + 3 * k + 3])
        rotation = out[7 * slots + 4 * k : 7 * slots + 4 * k + 4] + np.array([1, 0, 0, 0])
        mean = anchor + offset[3 * k : 3 * k + 3] * np.exp(scaling[:3])
        parts = (mean, scale, rotation / np.linalg.norm(rotation), [opacity], colour)
        found.append([k, *(float(f"{value:.9g}") for part in parts for value in part)])
    return found


def _sigmoid(values: Numbers) -> Numbers:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * values), np.float64)


def decoded(name: str) -> Scene:
    """The state at the end of a stream."""
    decoder = SceneDecoder()
    for packet in read_stream(FOLDER / f"{name}.slps"):
        decoder.push(packet)
    assert decoder.scene is not None
    return decoder.scene


def main() -> None:
    """Write the file."""
    views = []
    for name, eye, by_distance in VIEWS:
        found = gaussians(decoded(name), np.array(eye), by_distance)
        views.append({"file": f"{name}.slps", "eye": eye, "by_distance": by_distance, "gaussians": found})
    lines = json.dumps({"format": 1, "rows": MOST_ROWS, "tolerance": TOLERANCE, "views": views})
    PATH.write_text(lines.replace("[[", "[\n[").replace("], [", "],\n[") + "\n")


if __name__ == "__main__":
    main()
