"""The version of streamlod that is installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def streamlod_version() -> str:
    """Such as ``0.1.0``; ``unknown`` in a source folder that was not installed."""
    try:
        return version("streamlod")
    except PackageNotFoundError:
        return "unknown"
