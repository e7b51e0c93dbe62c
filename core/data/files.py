"""Small files from outside, read with limits and without trust."""

from __future__ import annotations

import codecs
import json
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.errors import InputError

MAX_TEXT_BYTES = 256 << 20


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Put the file's name before every `InputError` raised inside that lacks it, such as that of a camera's numbers."""
    try:
        yield
    except InputError as error:
        if error.subject == str(path):
            raise
        raise InputError(path, str(error)) from error


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """The file's bytes; InputError if it is missing or larger than `max_bytes`."""
    try:
        if path.stat().st_size > max_bytes:
            raise InputError(path, f"is larger than {max_bytes >> 20} MiB, the limit for such a file")
        return path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from error


def read_text(path: Path, undecodable: str = "strict") -> str:
    """The file's text, without the byte order mark that Windows editors put before it.

    Args:
        undecodable: ``surrogateescape`` keeps bytes that are not UTF-8, as Python's file names do.

    Raises:
        InputError: missing, very large or not UTF-8.
    """
    data = read_bytes(path, MAX_TEXT_BYTES)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):  # which `undecodable` would let through
        raise InputError(path, "is UTF-16 text; save it as UTF-8")
    try:
        return data.decode("utf-8-sig", undecodable)
    except UnicodeDecodeError as error:
        raise InputError(path, f"is not UTF-8 text (see byte {error.start}); save it as UTF-8") from error


def read_json(path: Path) -> dict[str, Any]:
    """The file's JSON object; InputError if it holds anything else."""
    try:
        value = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:  # ValueError also for integers of thousands of digits
        raise InputError(path, f"is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise InputError(path, "must hold a JSON object")
    return value


def read_array(path: Path) -> Float64:
    """A .npy file's array of numbers as float64; InputError for pickled objects, archives and damaged files."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers that are odd but readable
            array = np.load(path, mmap_mode="r", allow_pickle=False)  # mapping checks the shape against the size
        if not isinstance(array, np.ndarray):
            array.close()
            raise InputError(path, "is an archive; a single array is needed, written with numpy.save")
        return np.array(array, np.float64)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError, TypeError, SyntaxError, OverflowError, TokenError) as error:
        raise InputError(path, "does not hold an array of plain numbers, or is cut short") from error


def number(value: object, what: str, path: Path) -> float:
    """`value` as a float; InputError if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(path, f"{what} must be a number, not {value!r:.40}")
    try:
        return float(value)
    except OverflowError as error:
        raise InputError(path, f"{what} is too large for a number") from error


def numbers(value: object, shape: tuple[int, ...], what: str, path: Path) -> Float64:
    """`value` (nested lists) as a float64 array of `shape`; InputError if it is not one."""
    try:
        array = np.array(value, np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(path, f"{what} must be numbers of shape {'x'.join(map(str, shape))}") from error
    if array.shape != shape:
        raise InputError(path, f"{what} must be numbers of shape {'x'.join(map(str, shape))}, not {array.shape}")
    return array
