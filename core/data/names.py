"""Names of cameras and files: in the order of their numbers (cam_2 before cam_10), and fit to be shown and sent."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

MAX_NAME_BYTES = 64  # of a camera's name in the bitstream


def numeric_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorting key that compares runs of digits as integers and the rest as text."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(part), "") if part[0].isascii() and part.isdecimal() else (1, 0, part) for part in parts)


def in_numeric_order(names: Iterable[str]) -> list[str]:
    """`names`, sorted by their numbers."""
    return sorted(names, key=numeric_key)


def listed(names: Iterable[str], at_most: int = 40) -> str:
    """`names` joined for a message, cut when there are very many."""
    names = [_printable(name) for name in names]
    rest = f" and {len(names) - at_most} more" if len(names) > at_most else ""
    return ", ".join(names[:at_most]) + rest


def spoken(names: Iterable[str], at_most: int = 40) -> str:
    """`names` as a sentence has them, "a, b and c", cut as `listed` does."""
    names = list(names)
    if not 2 <= len(names) <= at_most:
        return listed(names, at_most)
    return f"{listed(names[:-1])} and {listed(names[-1:])}"


def counted(number: int, what: str) -> str:
    """So many of something as a sentence has them: "1 frame", "2 frames"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def files_in(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of `folder` with one of the lower-case `suffixes`, in numeric order; hidden files left out."""
    found = (p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".") and p.is_file())
    return sorted(found, key=lambda path: numeric_key(path.name))


def folders_in(folder: Path) -> list[Path]:
    """Folders of `folder` in numeric order, without hidden ones and those that archives of macOS leave behind."""
    found = (p for p in folder.iterdir() if not p.name.startswith((".", "__MACOSX")) and p.is_dir())
    return sorted(found, key=lambda path: numeric_key(path.name))


def inside(folder: Path, name: str) -> Path | None:
    """The path of `name` in `folder`, which a file from outside gives; None where it leads out of there.

    Links are not looked into: they are of whoever made the folder, as its files are.
    """
    here = folder.absolute()
    path = Path(os.path.normpath(here / name))
    return folder / path.relative_to(here) if path.is_relative_to(here) and path != here else None


def like_most(folders: Sequence[Path]) -> list[Path]:
    """Folders of `folders` whose names differ only in their digits, if that is more than half of them; else all.

    Names without digits count only where none has any, as a system's own folders have none (``@eaDir``).
    """
    folders = [folder for folder in folders if re.search(r"\d", folder.name)] or folders
    shapes = [re.sub(r"\d+", "0", folder.name) for folder in folders]
    common = Counter(shapes).most_common(1)
    if not common or 2 * common[0][1] <= len(folders):
        return list(folders)
    return [folder for folder, shape in zip(folders, shapes, strict=True) if shape == common[0][0]]


def instant_numbers(names: Sequence[str]) -> tuple[int, ...]:
    """How many periods after the first each of `names` lies, which are in numeric order and called by their number.

    A period is the least step between two of them, of which all steps are multiples: 10, 20 and 40 give 0, 1 and 3.
    What does not go by one number so, such as times in milliseconds, is counted: 0, 1, 2.
    """
    counted = tuple(range(len(names)))
    keys = [numeric_key(name) for name in names]
    differing = [part for part in zip(*keys, strict=False) if len(set(part)) > 1]
    if len({len(key) for key in keys}) > 1 or len(differing) != 1 or any(text for _, _, text in differing[0]):
        return counted
    numbers = [number for _, number, _ in differing[0]]
    steps = [after - before for before, after in pairwise(numbers)]
    if min(steps) == 0 or any(step % min(steps) for step in steps):
        return counted
    return tuple((number - numbers[0]) // min(steps) for number in numbers)


def camera_names(names: Sequence[str]) -> list[str]:
    """`names` as UTF-8 text of at most `MAX_NAME_BYTES`, of which long ones keep their end; equal ones stay equal.

    Bytes that were no UTF-8 become U+FFFD. What would become equal by this gets its number in front.
    """
    short = [_end(_printable(name), MAX_NAME_BYTES) for name in names]
    if len(set(short)) == len(set(names)):
        return short
    digits = len(str(len(names)))
    return [
        name if name == before else f"{number:0{digits}}-{_end(name, MAX_NAME_BYTES - digits - 1)}"
        for number, (before, name) in enumerate(zip(names, short, strict=True))
    ]


def _printable(name: str) -> str:
    """A name on one line, without what cannot be shown."""
    text = name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return "".join(character if character.isprintable() else "\ufffd" for character in text)


def _end(name: str, max_bytes: int) -> str:
    return name.encode()[-max_bytes:].decode(errors="ignore")
