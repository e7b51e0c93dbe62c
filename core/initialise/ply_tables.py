"""The tables of a PLY file, ascii or binary, up to its vertices. Files are hostile until shown otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from streamlod.core.errors import InputError

MAX_POINTS = 20_000_000
_MAX_HEADER_BYTES = 1 << 16
_MAX_PROPERTIES = 256
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_SCALARS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2",
    "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4",
    "double": "<f8", "float64": "<f8",
}  # fmt: skip

Tables = dict[str, NDArray[Any]]  # rows of each element, a field for each of their properties


@dataclass(frozen=True, slots=True)
class _Element:
    """One table as the header announces it; a property is a name and a numpy type."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class _Header:
    """Whether numbers are binary, the elements up to the vertices, and whether others follow."""

    binary: bool
    elements: tuple[_Element, ...]
    more: bool


def read_tables(path: Path) -> Tables:
    """The elements of a PLY file by name, the last of which is `vertex`; those behind it are passed over.

    Raises:
        InputError: the file cannot be read, is damaged or too large, has no vertices, or lists before or among them.
    """
    try:
        with path.open("rb") as file:
            header = _header(path, file)
            size_bytes = path.stat().st_size - file.tell()
            return (_binary_tables if header.binary else _ascii_tables)(path, file, header, size_bytes)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def _header(path: Path, file: BinaryIO) -> _Header:
    """The header, with the file left at the first byte after it."""
    lines: list[list[str]] = []
    while not lines or lines[-1] != ["end_header"]:
        line = file.readline(_MAX_HEADER_BYTES)
        if not line.endswith(b"\n") or file.tell() > _MAX_HEADER_BYTES:
            raise InputError(path, "is not a PLY file, or its header is cut off or too long")
        lines.append(line.decode("latin-1").split())  # comments may be in any language
        if len(lines) == 1 and lines[0] != ["ply"]:
            raise InputError(path, "is not a PLY file")
    lines = [words for words in lines[1:-1] if words and words[0] not in ("comment", "obj_info")]
    order = _ORDERS.get(lines[0][1]) if lines and lines[0][::2] == ["format", "1.0"] else None
    if order is None:
        raise InputError(path, f"is a PLY of another format than {', '.join(_ORDERS)} 1.0")
    begins = [*(index for index, words in enumerate(lines) if words[0] == "element"), len(lines)]
    names = [lines[begin][1:2] for begin in begins[:-1]]
    if ["vertex"] not in names or begins[0] != 1:
        raise InputError(path, "has no vertices, or properties before its first element")
    read = names.index(["vertex"]) + 1
    elements = tuple(_element(path, lines[begins[n] : begins[n + 1]], order) for n in range(read))
    return _Header(lines[0][1] != "ascii", elements, len(names) > read)


def _element(path: Path, lines: list[list[str]], order: str) -> _Element:
    properties = tuple(_property(path, words, order) for words in lines[1:])
    names = [name for name, _ in properties]
    if not 1 <= len(names) <= _MAX_PROPERTIES or len(set(names)) != len(names) or len(lines[0]) != 3:
        raise InputError(path, f"names no property, too many or one twice of {' '.join(lines[0])[:60]!r}")
    name, word = lines[0][1:]
    if not (word.isdecimal() and len(word) <= 12 and int(word) <= MAX_POINTS):
        raise InputError(path, f"has {word[:20]} rows of {name[:20]!r}; at most {MAX_POINTS} are read")
    return _Element(name, int(word), properties)


def _property(path: Path, words: list[str], order: str) -> tuple[str, str]:
    if len(words) != 3 or words[0] != "property" or words[1] not in _SCALARS:
        raise InputError(path, f"has a line in its header that is not a scalar property: {' '.join(words)[:60]!r}")
    return words[2], _SCALARS[words[1]].replace("<", order)


def _binary_tables(path: Path, file: BinaryIO, header: _Header, size_bytes: int) -> Tables:
    dtypes = [np.dtype(list(element.properties)) for element in header.elements]
    sizes = [element.count * dtype.itemsize for element, dtype in zip(header.elements, dtypes, strict=True)]
    wanted = sum(sizes)
    if size_bytes < wanted:
        raise InputError(path, f"is cut off: {wanted} bytes of points are announced, {size_bytes} are there")
    if size_bytes > wanted and not header.more:
        raise InputError(path, f"has {size_bytes - wanted} bytes too many after its points")
    parts = zip(header.elements, sizes, dtypes, strict=True)
    return {element.name: np.frombuffer(file.read(size), dtype) for element, size, dtype in parts}


def _ascii_tables(path: Path, file: BinaryIO, header: _Header, size_bytes: int) -> Tables:
    wanted = sum(element.count * len(element.properties) for element in header.elements)
    if size_bytes + 1 < 2 * wanted:  # a digit and a blank are the least a number takes
        raise InputError(path, f"is cut off: it is too short for {wanted} numbers")
    words = file.read(size_bytes if wanted else 0).split(maxsplit=wanted)
    if len(words) < wanted:
        raise InputError(path, f"is cut off: {wanted} numbers are announced, {len(words)} are there")
    if len(words) > wanted and not header.more:
        raise InputError(path, "has text after its points")
    tables, begin = {}, 0
    for element in header.elements:
        end = begin + element.count * len(element.properties)
        tables[element.name] = _ascii_table(path, element, words[begin:end])
        begin = end
    return tables


def _ascii_table(path: Path, element: _Element, words: list[bytes]) -> NDArray[Any]:
    table = np.zeros(element.count, np.dtype([(name, "<f8") for name, _ in element.properties]))
    try:
        for column, (name, _) in enumerate(element.properties):
            table[name] = np.array(words[column :: len(element.properties)]).astype(np.float64)
    except ValueError as error:
        raise InputError(path, "has a point that is not made of numbers") from error
    integers = [(name, kind if kind[-2] != "f" else "<f8") for name, kind in element.properties]
    with np.errstate(invalid="ignore"):
        return table.astype(np.dtype(integers))
