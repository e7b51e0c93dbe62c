"""Which cameras train and which are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.data.files import read_json
from streamlod.core.data.names import in_numeric_order, listed
from streamlod.core.errors import InputError


@dataclass(frozen=True, slots=True)
class Split:
    """Cameras to train on and cameras to test on, by name.

    Attributes:
        name: how the split came about, for reports.
        train: training cameras. test: held-out cameras, possibly none.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]


def linspace_split(names: Sequence[str], views: int | None, test: Sequence[str] = ()) -> Split:
    """Training cameras round(linspace(0, n - 1, views)) of the n in numeric order, the held-out ones removed first.

    Args:
        names: all cameras. views: number of training cameras, or None for all that remain. test: held-out cameras.

    Raises:
        InputError: a held-out camera that does not exist, or more views than cameras remain.
    """
    _check_known(test, names, "--test")
    remaining = in_numeric_order(name for name in names if name not in test)
    if not remaining:
        raise InputError("--test", f"holds out {listed(names)}, which are all cameras; leave some to train")
    views = len(remaining) if views is None else views
    if not 1 <= views <= len(remaining):
        raise InputError("--views", f"{views} training cameras asked for, of {len(remaining)} that are not held out")
    rows = np.round(np.linspace(0, len(remaining) - 1, views)).astype(int)
    held_out = f" without {listed(test)}" if test else ""
    return Split(f"linspace {views} of {len(remaining)}{held_out}", tuple(remaining[row] for row in rows), tuple(test))


def training_cameras(
    names: Sequence[str], train: Sequence[str], views: int | None, test: Sequence[str]
) -> tuple[str, ...]:
    """Cameras that train: `train` where it names some, else those of `linspace_split`.

    Args:
        names: all cameras. train, views, test: as the options of these names.

    Raises:
        InputError: a camera that does not exist or is named twice, more views than cameras remain, or another number
            of them than `train` names.
    """
    if not train:
        return linspace_split(names, views, test).train
    if len(set(train)) < len(train):
        raise InputError("--train", "names a camera twice")
    if views not in {None, len(train)}:
        raise InputError(
            "--views", f"asks for {views} training cameras, but --train names {len(train)}; leave one away"
        )
    _check_known(train, names, "--train")
    _check_known(test, names, "--test")
    return tuple(train)


def read_split(path: Path, names: Sequence[str]) -> Split:
    """A split from a JSON file: ``{"train": ["cam01", ...], "test": ["cam00"]}``, ``"test"`` optional.

    Raises:
        InputError: not such a file, a camera that does not exist, or one that both trains and tests.
    """
    value = read_json(path)
    lists = []
    for key in ("train", "test"):
        entry = value.get(key, [])
        if not isinstance(entry, list) or not all(isinstance(name, str) for name in entry):
            raise InputError(path, f"{key!r} must be a list of camera names")
        if len(set(entry)) < len(entry):
            raise InputError(path, f"{key!r} names a camera twice")
        _check_known(entry, names, str(path))
        lists.append(tuple(entry))
    train, test = lists
    if not train:
        raise InputError(path, "'train' must name at least one camera")
    both = set(train) & set(test)
    if both:
        raise InputError(path, f"{listed(sorted(both))} both train and test")
    return Split(path.name, train, test)


def _check_known(wanted: Sequence[str], names: Sequence[str], subject: str) -> None:
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise InputError(subject, f"there is no camera {listed(unknown)}; there are {listed(in_numeric_order(names))}")
