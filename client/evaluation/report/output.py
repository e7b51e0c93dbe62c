"""Result files, which are either complete or absent."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.errors import InputError
from streamlod.core.files import write_text


def result_folder(path: Path) -> Path:
    """`path`, made if it was not there; InputError where nothing can be written."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be made a folder of results ({error.strerror})") from error
    return path


def write_json(path: Path, value: Any) -> None:
    """Write strict JSON; raises ValueError for a number that is not finite."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")


def side_by_side(truth: UInt8, drawn: UInt8) -> UInt8:
    """[H,3W,3]: truth, rendering, and their absolute difference times four."""
    difference = np.minimum(np.abs(truth.astype(np.int16) - drawn) * 4, 255).astype(np.uint8)
    return np.concatenate([truth, drawn, difference], axis=1)
