"""SPZ files, versions 2 to 4; spherical harmonics beyond degree 0 are dropped. Files are hostile."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from streamlod.codec.export import spz4
from streamlod.codec.export.ply import SH_C0
from streamlod.core.arrays import Float32, UInt8
from streamlod.core.errors import InputError
from streamlod.core.scene.gaussians import GaussianCloud, as_cloud

MAX_GAUSSIANS = 20_000_000
_MAX_BYTES = 1 << 30  # of a file
_HEADER = struct.Struct("<4xIIBBBB")
_MAGIC = b"NGSP"
_GZIP = 31  # zlib's name for gzip with the widest window
_COLUMNS = {2: (9, 1, 3, 3, 3), 3: (9, 1, 3, 3, 4), 4: (9, 1, 3, 3, 4)}  # bytes of a row, in the file's order
_AXES = np.array([1, -1, -1], np.float32)  # the format is right-up-back, a scene right-down-forward


def decode_spz(path: Path) -> GaussianCloud:
    """The Gaussians of a file.

    Raises:
        InputError: the file cannot be read, is damaged, too large, or of another version.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(path, f"is larger than {_MAX_BYTES} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    if data.startswith(_MAGIC):
        version, count, bits = _announced(path, data, (4,))
        body = spz4.unpack(path, data, [count * size for size in _COLUMNS[version]])
    else:
        version, count, bits, body = _inflated(path, data)
    return _cloud(np.frombuffer(body, np.uint8), count, version, bits)


def _announced(path: Path, head: bytes, versions: tuple[int, ...]) -> tuple[int, int, int]:
    """Version, number of Gaussians, and bits behind the point."""
    if len(head) < _HEADER.size:
        raise InputError(path, "is no SPZ file, or is cut off")
    version, count, _, bits, _, _ = _HEADER.unpack_from(head)
    if not head.startswith(_MAGIC) or version not in versions:
        raise InputError(path, "is no SPZ file of version 2, 3 or 4; other versions are not read here")
    if count > MAX_GAUSSIANS or bits > 31:
        raise InputError(path, f"announces {count} Gaussians; at most {MAX_GAUSSIANS} are read")
    return version, count, bits


def _inflated(path: Path, data: bytes) -> tuple[int, int, int, bytes]:
    """Version, number of Gaussians, bits behind the point, and rows of a file of version 2 or 3."""
    inflater = zlib.decompressobj(_GZIP)
    try:
        version, count, bits = _announced(path, inflater.decompress(data, _HEADER.size), (2, 3))
        wanted = count * sum(_COLUMNS[version])
        body = inflater.decompress(inflater.unconsumed_tail, wanted) if wanted else b""
    except zlib.error as error:
        raise InputError(path, "is no SPZ file of version 2, 3 or 4, or is damaged") from error
    if len(body) < wanted:
        raise InputError(path, f"is cut off: {wanted} bytes of Gaussians are announced, {len(body)} are there")
    return version, count, bits, body


def _cloud(body: UInt8, count: int, version: int, bits: int) -> GaussianCloud:
    ends = np.cumsum([9, 1, 3, 3]) * count
    places, opacities, colours, scales, rotations = np.split(body, ends)
    triples = places.reshape(count, 3, 3).astype(np.int32)
    fixed = triples[..., 0] | triples[..., 1] << 8 | triples[..., 2] << 16
    means = (fixed - ((fixed & 0x800000) << 1)).astype(np.float64) / 2.0**bits
    quaternions = (_plain if version == 2 else _packed)(rotations.reshape(count, _COLUMNS[version][-1]))
    colour = (colours.reshape(count, 3) / 255.0 - 0.5) / 0.15 * SH_C0 + 0.5
    return as_cloud(
        means * _AXES,
        quaternions * np.append(np.float32(1), _AXES),
        np.exp(scales.reshape(count, 3) / 16.0 - 10.0),
        opacities / 255.0,
        np.clip(colour, 0, 1),
    )


def _plain(rows: UInt8) -> Float32:
    """[G,4] w x y z of version 2: x, y, z as bytes, w from the length of 1."""
    xyz = rows.astype(np.float32) / 127.5 - 1
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1, keepdims=True), 0))
    return np.concatenate([w, xyz], axis=1)


def _packed(rows: UInt8) -> Float32:
    """[G,4] w x y z of versions 3 and 4: the index of the largest of x y z w, the others as sign and 9 bits."""
    words = np.ascontiguousarray(rows).view("<u4")[:, 0].astype(np.int64)
    largest, xyzw = words >> 30, np.zeros((len(words), 4))
    for axis in range(3, -1, -1):
        other = largest != axis
        values = (words & 511) / 511.0 * np.sqrt(0.5) * np.where(words >> 9 & 1, -1, 1)
        xyzw[:, axis] = np.where(other, values, 0)
        words = np.where(other, words >> 10, words)
    rest = np.sqrt(np.maximum(1 - (xyzw**2).sum(axis=1), 0))
    xyzw[np.arange(len(xyzw)), largest] = rest
    return np.roll(xyzw, 1, axis=1).astype(np.float32)
