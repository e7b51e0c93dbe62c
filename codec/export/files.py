"""Writing snapshot files, which are either complete or absent."""

from __future__ import annotations

from pathlib import Path

from streamlod.codec.snapshots import FORMATS
from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes
from streamlod.core.scene.gaussians import GaussianCloud


def write_snapshot(path: Path, cloud: GaussianCloud, file_format: str, comment: str) -> int:
    """Write `cloud` to the file `path`; returns its size in bytes.

    Args:
        file_format: a name in `FORMATS`.
        comment: one line, for formats that have room for it.

    Raises:
        InputError: unknown format, positions that the format cannot hold, or a place that cannot be written.
    """
    if file_format not in FORMATS:
        raise InputError(file_format, f"is not a snapshot format; choose from {', '.join(FORMATS)}")
    try:
        data = FORMATS[file_format].encode(cloud, comment)
    except ValueError as error:
        raise InputError(path, str(error)) from error
    write_bytes(path, data)
    return len(data)
