"""Gaussians to import, and a writer of compressed PLY."""

from __future__ import annotations

import numpy as np

from streamlod.core.scene.gaussians import GaussianCloud

BOUNDS = tuple(f"{end}_{axis}" for kind in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
               for end in ("min", "max") for axis in kind)  # fmt: skip
WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def compressed_ply(cloud: GaussianCloud, with_colours: bool = True, harmonics: int = 0) -> bytes:
    """A compressed PLY, as SuperSplat writes them."""
    bounds, words = [], []
    for first in range(0, len(cloud), 256):
        rows = slice(first, first + 256)
        columns = (cloud.means[rows], np.log(cloud.scales[rows]), cloud.colours[rows])
        lows, highs = [c.min(axis=0) for c in columns], [c.max(axis=0) for c in columns]
        if not with_colours:
            lows[2], highs[2] = np.zeros(3), np.ones(3)
        shares = [(c - low) / (high - low) for c, low, high in zip(columns, lows, highs, strict=True)]
        turns = cloud.quaternions[rows] / np.linalg.norm(cloud.quaternions[rows], axis=1, keepdims=True)
        bounds.append(np.concatenate([each for pair in zip(lows, highs, strict=True) for each in pair]))
        words.append(
            np.stack(
                [
                    _word(shares[0], (11, 10, 11)),
                    _rotation(turns),
                    _word(shares[1], (11, 10, 11)),
                    _word(np.concatenate([shares[2], cloud.opacities[rows, None]], axis=1), (8, 8, 8, 8)),
                ],
                axis=1,
            )
        )
    kept = 18 if with_colours else 12
    head = ["ply", "format binary_little_endian 1.0", "comment a test", f"element chunk {len(bounds)}"]
    head += [f"property float {name}" for name in BOUNDS[:kept]] + [f"element vertex {len(cloud)}"]
    head += [f"property uint {name}" for name in WORDS]
    if harmonics:
        head += [f"element sh {len(cloud)}", *(f"property uchar f_rest_{n}" for n in range(harmonics))]
    body = np.stack(bounds)[:, :kept].astype("<f4").tobytes() + np.concatenate(words).astype("<u4").tobytes()
    return "\n".join([*head, "end_header", ""]).encode() + body + bytes(len(cloud) * harmonics)


def _word(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    word = np.zeros(len(shares), np.int64)
    for column, width in enumerate(bits):
        word = word << width | np.round(shares[:, column] * ((1 << width) - 1)).astype(np.int64)
    return word


def _rotation(quaternions: np.ndarray) -> np.ndarray:
    largest = np.abs(quaternions).argmax(axis=1)
    words = []
    for quaternion, index in zip(quaternions, largest, strict=True):
        others = np.delete(quaternion * np.sign(quaternion[index]), index) / np.sqrt(2) + 0.5
        words.append(int(index) << 30 | int(_word(others[None], (10, 10, 10))[0]))
    return np.array(words)


def some_cloud(frame: int = 0, count: int = 400, growth: float = 0.05) -> GaussianCloud:
    """Gaussians that sway, turn, and grow by a share with each frame."""
    rng = np.random.default_rng(1)
    means, quaternions = rng.normal(0, 1, (count, 3)), rng.normal(0, 1, (count, 4))
    means[:, 0] += 0.1 * frame * np.sin(means[:, 1])
    quaternions[:, 1] += 0.2 * frame
    scales = np.exp(rng.normal(-4, 1, (count, 3))) * (1 + growth * frame)
    parts = (means, quaternions, scales, rng.uniform(0.05, 0.99, count), rng.uniform(0.02, 0.98, (count, 3)))
    return GaussianCloud(*(part.astype(np.float32) for part in parts))
