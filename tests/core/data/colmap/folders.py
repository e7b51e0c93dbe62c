"""COLMAP folders to read: a small rig's model in either format, and its pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.camera import Camera
from tests.core.data.writers import picture, rig, write_colmap_binary, write_colmap_text, write_picture

NAMES = ("cam00", "cam02", "cam10")
POINTS = np.array([[0.5, -1, 2, 255, 128, 0], [1, 2, 3, 10, 20, 30]])
Writer = Callable[..., None]
both_formats = pytest.mark.parametrize("write", [write_colmap_binary, write_colmap_text], ids=["binary", "text"])


def one_instant(folder: Path, write: Writer) -> tuple[Camera, ...]:
    """Write pictures of one instant and their model, in whose file cameras are not in the order of their names."""
    cameras = rig(NAMES)
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in cameras]
    write(folder / "sparse" / "0", entries[::-1], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(folder / "images" / f"{name}.png", picture(index, 0))
    return cameras
