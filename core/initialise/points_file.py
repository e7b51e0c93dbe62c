"""Points from a file: ``.ply`` (ascii or binary) or ``.npz``. Files are hostile until shown otherwise."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.ply_tables import MAX_POINTS, read_tables

SUFFIXES = (".ply", ".npz")
_SH_BAND_0 = 1 / (2 * math.sqrt(math.pi))  # splat files keep colour as 0.5 + this times f_dc
_GREY = 0.5  # the colour of points that have none
_POSITION_NAMES, _COLOUR_NAMES = ("positions", "points", "xyz"), ("colours", "colors", "rgb")


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


def _read_ply(path: Path) -> tuple[NDArray[Any], Float32]:
    table = read_tables(path)["vertex"]
    names = set(table.dtype.names or ())
    if "packed_position" in names:
        plain = "`npx @playcanvas/splat-transform in.ply out.ply` makes a plain one"
        raise InputError(path, f"is a compressed PLY, of which points are not read; {plain}")
    if not {"x", "y", "z"} <= names:
        raise InputError(path, "its vertices lack x, y or z")
    return np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64), _ply_colours(table)


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
