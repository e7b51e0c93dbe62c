"""Points from a file: ``.ply`` (ascii or binary) or ``.npz``. Files are hostile until shown otherwise."""

from __future__ import annotations

import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud

SUFFIXES = (".ply", ".npz")
MAX_POINTS = 20_000_000
_MAX_HEADER_BYTES = 1 << 16
_MAX_PROPERTIES = 256
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_SCALARS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2",
    "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4",
    "double": "<f8", "float64": "<f8",
}  # fmt: skip
_SH_BAND_0 = 1 / (2 * math.sqrt(math.pi))  # splat files keep colour as 0.5 + this times f_dc
_GREY = 0.5  # the colour of points that have none
_POSITION_NAMES, _COLOUR_NAMES = ("positions", "points", "xyz"), ("colours", "colors", "rgb")


@dataclass(frozen=True, slots=True)
class _Header:
    """The facts of a PLY header: format, number of vertices, (name, numpy type) of each property, other elements."""

    binary: bool
    count: int
    properties: tuple[tuple[str, str], ...]
    more: bool


def read_points(path: Path, space: Similarity = UNCHANGED) -> PointCloud:
    """Positions and colours of a file of points, brought from the file's coordinates into `space`.

    A PLY needs ``x y z``; colours are ``red green blue`` (integers of 255, or floats in [0, 1]) or ``f_dc_0..2``. An
    NPZ needs ``positions`` [N,3] (or ``points``, ``xyz``); colours are ``colours`` (or ``colors``, ``rgb``) [N,3],
    uint8 or floats in [0, 1]. Points without colour are grey.

    Raises:
        InputError: the file cannot be read, is damaged, too large, or holds numbers that are not finite.
    """
    reader = {".ply": _read_ply, ".npz": _read_npz}.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, "is not a .ply or .npz file")
    try:
        positions, colours = reader(path)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if len(positions) == 0:
        raise InputError(path, "holds no points")
    if not np.isfinite(positions).all() or not np.isfinite(colours).all():
        raise InputError(path, "holds positions or colours that are not finite")
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused as such
        positions = space.positions(positions.astype(np.float64)).astype(np.float32)
    if not np.isfinite(positions).all():
        raise InputError(path, "holds positions that are not finite as 32-bit numbers")
    return PointCloud(np.ascontiguousarray(positions), np.clip(colours, 0, 1).astype(np.float32))


def read_vertices(path: Path) -> NDArray[Any]:
    """The vertices of a PLY file, a field for each of their properties.

    Raises:
        InputError: the file cannot be read, is damaged or too large.
    """
    try:
        with path.open("rb") as file:
            header = _ply_header(path, file)
            size_bytes = path.stat().st_size - file.tell()
            return (_binary_table if header.binary else _ascii_table)(path, file, header, size_bytes)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def _read_ply(path: Path) -> tuple[NDArray[Any], Float32]:
    table = read_vertices(path)
    if not {"x", "y", "z"} <= set(table.dtype.names or ()):
        raise InputError(path, "its vertices lack x, y or z")
    return np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64), _ply_colours(table)


def _ply_header(path: Path, file: BinaryIO) -> _Header:
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
    elements = [index for index, words in enumerate(lines) if words[0] == "element"]
    if elements and lines[elements[0]][1:2] == ["chunk"]:
        raise InputError(
            path, "is a compressed PLY; `npx @playcanvas/splat-transform in.ply out.ply` makes a plain one"
        )
    if not elements or lines[elements[0]][1:2] != ["vertex"] or len(lines[elements[0]]) != 3:
        raise InputError(path, "must begin with its vertices")
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = tuple(_property(path, words, order) for words in lines[elements[0] + 1 : end])
    names = [name for name, _ in properties]
    if not 1 <= len(names) <= _MAX_PROPERTIES or len(set(names)) != len(names):
        raise InputError(path, "names no properties of its vertices, too many, or one twice")
    return _Header(lines[0][1] != "ascii", _count(path, lines[elements[0]][2]), properties, len(elements) > 1)


def _property(path: Path, words: list[str], order: str) -> tuple[str, str]:
    if len(words) != 3 or words[0] != "property" or words[1] not in _SCALARS:
        raise InputError(path, f"has a line in its header that is not a scalar property: {' '.join(words)[:60]!r}")
    return words[2], _SCALARS[words[1]].replace("<", order)


def _count(path: Path, word: str) -> int:
    if not (word.isdecimal() and len(word) <= 12 and int(word) <= MAX_POINTS):
        raise InputError(path, f"has {word[:20]} points; at most {MAX_POINTS} are read")
    return int(word)


def _binary_table(path: Path, file: BinaryIO, header: _Header, size_bytes: int) -> NDArray[Any]:
    dtype = np.dtype(list(header.properties))
    wanted = header.count * dtype.itemsize
    if size_bytes < wanted:
        raise InputError(path, f"is cut off: {wanted} bytes of points are announced, {size_bytes} are there")
    if size_bytes > wanted and not header.more:
        raise InputError(path, f"has {size_bytes - wanted} bytes too many after its points")
    return np.frombuffer(file.read(wanted), dtype)


def _ascii_table(path: Path, file: BinaryIO, header: _Header, size_bytes: int) -> NDArray[Any]:
    columns = len(header.properties)
    if size_bytes + 1 < 2 * header.count * columns:  # a digit and a blank are the least a number takes
        raise InputError(path, f"is cut off: it is too short for {header.count} points")
    words = file.read(size_bytes if header.count else 0).split(maxsplit=header.count * columns)
    table = np.zeros(header.count, np.dtype([(name, "<f8") for name, _ in header.properties]))
    if len(words) < header.count * columns:
        raise InputError(path, f"is cut off: {header.count} points are announced, {len(words) // columns} are there")
    if len(words) > header.count * columns and not header.more:
        raise InputError(path, "has text after its points")
    try:
        for column, (name, _) in enumerate(header.properties):
            table[name] = np.array(words[column : header.count * columns : columns]).astype(np.float64)
    except ValueError as error:
        raise InputError(path, "has a point that is not made of numbers") from error
    integers = [(name, kind if kind[-2] != "f" else "<f8") for name, kind in header.properties]
    with np.errstate(invalid="ignore"):
        return table.astype(np.dtype(integers))


def _ply_colours(table: NDArray[Any]) -> Float32:
    names = set(table.dtype.names or ())
    if {"red", "green", "blue"} <= names:
        return np.stack([_unit(table[name]) for name in ("red", "green", "blue")], axis=1)
    if {"f_dc_0", "f_dc_1", "f_dc_2"} <= names:
        coefficients = np.stack([table[f"f_dc_{band}"] for band in range(3)], axis=1)
        return np.asarray(0.5 + _SH_BAND_0 * coefficients, np.float32)
    return np.full((len(table), 3), _GREY, np.float32)


def _unit(values: NDArray[Any]) -> Float32:
    """Colours in [0, 1]: integers are of 255."""
    scale = 1.0 if values.dtype.kind == "f" else 255.0
    return np.asarray(values / scale, np.float32)


def _read_npz(path: Path) -> tuple[NDArray[Any], Float32]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = set(archive.namelist())
            position = next((name for name in _POSITION_NAMES if f"{name}.npy" in members), None)
            colour = next((name for name in _COLOUR_NAMES if f"{name}.npy" in members), None)
            if position is None:
                raise InputError(path, "holds no array named positions")
            positions = _member(path, archive, position)
            colours = None if colour is None else _member(path, archive, colour)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError) as error:
        raise InputError(path, f"is not a usable .npz file: {error}") from error
    if positions.dtype.kind != "f":
        raise InputError(path, f"its {position} are {positions.dtype}, not floats")
    if colours is None:
        return positions, np.full(positions.shape, _GREY, np.float32)
    if len(colours) != len(positions):
        raise InputError(path, f"has {len(positions)} positions but {len(colours)} colours")
    return positions, _unit(colours)


def _member(path: Path, archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """A [N,3] array of an archive; its header is believed only after it was compared with limits."""
    with archive.open(f"{name}.npy") as file:
        try:
            version = np.lib.format.read_magic(file)
            reader = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
            shape, by_columns, dtype = reader(file)
        except (ValueError, KeyError) as error:
            raise InputError(path, f"its array {name} has a damaged header") from error
        if len(shape) != 2 or shape[1] != 3 or not 0 <= shape[0] <= MAX_POINTS:
            raise InputError(path, f"its array {name} has shape {shape}, not N x 3 with at most {MAX_POINTS} rows")
        if dtype.kind != "f" and dtype != np.uint8:
            raise InputError(path, f"its array {name} holds {dtype}, not floats or uint8")
        wanted = shape[0] * 3 * dtype.itemsize
        data = file.read(wanted + 1)
    if len(data) != wanted:
        raise InputError(path, f"its array {name} is not of the size that its header says")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
