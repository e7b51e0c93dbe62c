"""Names of cameras and files in the order of their numbers: cam_2 before cam_10."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path


def numeric_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorting key that compares runs of digits as integers and the rest as text."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(part), "") if part[0].isascii() and part.isdecimal() else (1, 0, part) for part in parts)


def in_numeric_order(names: Iterable[str]) -> list[str]:
    """`names`, sorted by their numbers."""
    return sorted(names, key=numeric_key)


def listed(names: Iterable[str], at_most: int = 40) -> str:
    """`names` joined for a message, cut when there are very many."""
    names = list(names)
    rest = f" and {len(names) - at_most} more" if len(names) > at_most else ""
    return ", ".join(names[:at_most]) + rest


def files_in(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of `folder` with one of the lower-case `suffixes`, in numeric order; hidden files left out."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".") and p.is_file())
    return sorted(found, key=lambda path: numeric_key(path.name))
