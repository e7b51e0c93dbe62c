"""SPZ, versions 3 and 4: 24-bit fixed-point positions, 8-bit colours, scales and opacities, smallest-three rotations.

Written from the format's public description (github.com/nianticlabs/spz); no spherical harmonics beyond degree 0.
Axes are the format's own, right-up-back: the scene and our .ply are right-down-forward.
"""

from __future__ import annotations

import gzip
import struct

import numpy as np

from streamlod.codec.export import spz4
from streamlod.codec.export.ply import SH_C0, unit_quaternions
from streamlod.core.arrays import Float32, Float64, UInt8
from streamlod.core.scene.gaussians import GaussianCloud

_MAGIC = 0x5053474E  # "NGSP"
_HEADER = struct.Struct("<IIIBBB")  # magic, version, count, SH degree, fractional bits, flags
_AXES = np.array([1, -1, -1], np.float32)  # a half turn about x
_MAX_POSITION = (1 << 23) - 1
_FINEST = 20  # fractional bits: a unit is a millionth
_COLOUR_SCALE = 0.15
_NINE_BITS = (1 << 9) - 1  # magnitude of a rotation component
_LEVEL = 6  # of gzip


def encode_spz(cloud: GaussianCloud, version: int = 3) -> bytes:
    """The file's bytes.

    Args:
        version: 3, which more programs read, or 4, which is smaller.

    Raises:
        ValueError: positions reach beyond 8 million units, which the format cannot hold.
        InputError: version 4 needs a package that is not there.
    """
    means, quaternions = cloud.means * _AXES, unit_quaternions(cloud.quaternions) * np.append(np.float32(1), _AXES)
    bits = _fractional_bits(means)
    head = _HEADER.pack(_MAGIC, version, len(cloud), 0, bits, 0)
    streams = (
        _positions(means.astype(np.float64), bits),
        _bytes(cloud.opacities * 255).tobytes(),
        _bytes(((cloud.colours - 0.5) / SH_C0 * _COLOUR_SCALE + 0.5) * 255).tobytes(),
        _bytes((np.log(np.maximum(cloud.scales, 1e-12)) + 10) * 16).tobytes(),
        _rotations(quaternions),
    )
    if version == 4:
        return spz4.pack(head, streams)
    return gzip.compress(b"".join((head, b"\0", *streams)), _LEVEL, mtime=0)


def _fractional_bits(means: Float32) -> int:
    """Number of bits behind the point: as many as the farthest coordinate leaves."""
    farthest = float(np.abs(means).max(initial=0))
    for bits in range(_FINEST, -1, -1):
        if farthest * 2.0**bits <= _MAX_POSITION - 1:
            return bits
    raise ValueError(f"a coordinate of {farthest:.3g} does not fit the 24 bits of SPZ")


def _positions(means: Float64, bits: int) -> bytes:
    fixed = np.round(means * 2.0**bits).astype("<i4")
    return fixed.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()


def _bytes(values: Float32) -> UInt8:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _rotations(quaternions: Float32) -> bytes:
    """The index of the largest component (x y z w), then the three others as sign and 9-bit magnitude."""
    xyzw = np.roll(quaternions, -1, axis=1)
    largest = np.abs(xyzw).argmax(axis=1)
    rows = np.arange(len(xyzw))
    xyzw = np.where(xyzw[rows, largest][:, None] < 0, -xyzw, xyzw)
    packed = largest.astype(np.uint32)
    magnitude = np.minimum(np.round(np.abs(xyzw) * np.sqrt(2) * _NINE_BITS), _NINE_BITS).astype(np.uint32)
    field = (xyzw < 0).astype(np.uint32) << 9 | magnitude
    for axis in range(4):
        packed = np.where(largest == axis, packed, packed << 10 | field[:, axis])
    return bytes(packed.astype("<u4").tobytes())
