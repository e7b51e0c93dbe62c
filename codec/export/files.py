"""Snapshot files, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from codec.export.ply import encode_ply
from codec.export.spz import encode_spz
from core.errors import InputError
from core.scene.gaussians import GaussianCloud

FORMATS = ("ply", "spz")


def write_snapshot(path: Path, cloud: GaussianCloud, file_format: str, comment: str) -> int:
    """Write `cloud` to `path` under a temporary name and rename it; returns the file's size in bytes.

    Args:
        file_format: "ply" or "spz"; SPZ has no room for the comment.

    Raises:
        InputError: unknown format, or positions that the format cannot hold.
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
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return len(data)
