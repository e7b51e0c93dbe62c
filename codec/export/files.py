"""Writing snapshot files, which are either complete or absent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from streamlod.codec.export.ply import encode_ply
from streamlod.codec.export.spz import encode_spz
from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes
from streamlod.core.scene.gaussians import GaussianCloud

FORMATS = ("ply", "spz")


def write_snapshot(path: Path, cloud: GaussianCloud, file_format: str, comment: str) -> int:
    """Write `cloud` to the file `path`; returns its size in bytes.

    Args:
        file_format: "ply" or "spz"; SPZ has no room for the comment.

    Raises:
        InputError: unknown format, positions that the format cannot hold, or a place that cannot be written.
    """
    encoders: dict[str, Callable[[], bytes]] = {
        "ply": lambda: encode_ply(cloud, comment),
        "spz": lambda: encode_spz(cloud),
    }
    if file_format not in encoders:
        raise InputError(file_format, f"is not a snapshot format; choose from {', '.join(FORMATS)}")
    try:
        data = encoders[file_format]()
    except ValueError as error:
        raise InputError(path, str(error)) from error
    write_bytes(path, data)
    return len(data)
