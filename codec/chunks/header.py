"""HEADER and WEIGHTS chunks: what a keyframe fixes. FORMAT.md sections 4 and 5."""

from __future__ import annotations

import math
import struct

import numpy as np

from streamlod.codec.packet.limits import DecoderLimits
from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.anchors import (
    FEATURE_LATENTS,
    HIDDEN,
    OFFSET_LATENTS,
    OUTPUTS,
    SCALINGS,
    VIEW_INPUTS,
    AnchorWeights,
    SceneHeader,
)
from streamlod.core.scene.octree import Octree

_COUNTS = struct.Struct("<BBBBB3x")
_GEOMETRY = struct.Struct("<6d")
_SIZE = struct.Struct("<II")
_CAMERA_DOUBLES = 9 + 12 + 5
_MAX_NAME_BYTES = 64
_MAX_PICTURE = 65535
_MAX_LENGTH, _MIN_LENGTH = 1e9, 1e-6  # of world units and steps: no float32 of a Gaussian leaves its range with these
_MAX_FPS, _MIN_FPS = 10_000.0, 0.001
_MAX_CAMERA_NUMBER = 1e12


def encode_header(header: SceneHeader) -> bytes:
    """The HEADER chunk.

    Raises:
        ValueError: more levels, cameras or features than the format holds, or numbers outside its bounds.
    """
    octree, features = header.octree, len(header.feature_steps)
    view_dependent = int(header.view_dependent)
    fixed = _COUNTS.pack(octree.levels, header.gaussians_per_anchor, features, view_dependent, len(header.cameras))
    numbers = (*octree.origin, octree.root_cell, header.reference_distance, header.fps)
    floats = (header.background, header.position_steps, header.feature_steps, header.offset_steps, header.scaling_steps)
    parts = [fixed, _GEOMETRY.pack(*numbers), *(part.astype("<f4").tobytes() for part in floats)]
    parts += [_encode_camera(camera) for camera in header.cameras]
    data = b"".join(parts)
    try:
        decode_header(data, DecoderLimits())
    except BitstreamError as error:
        raise ValueError(f"the scene header cannot be sent: {error.detail}") from error
    return data


def decode_header(data: bytes, limits: DecoderLimits) -> SceneHeader:
    """The header in a HEADER chunk.

    Raises:
        BitstreamError: `bad_scene_header` or `limit_exceeded`.
    """
    reader = _HeaderReader(data)
    levels, slots, features, view_dependent, camera_count = _COUNTS.unpack(reader.take(_COUNTS.size))
    for name, count, most in (
        ("levels", levels, limits.levels),
        ("Gaussians an anchor", slots, limits.gaussians_per_anchor),
        ("features", features, limits.features),
        ("cameras", camera_count, limits.cameras),
    ):
        if count > most:
            raise BitstreamError("limit_exceeded", f"{count} {name} exceed the limit of {most}")
    if not (1 <= levels <= 16 and 1 <= slots <= 16 and 1 <= features <= 64 and view_dependent <= 1):
        raise _bad("counts of levels, Gaussians or features are out of range")
    if any(data[5:8]):
        raise _bad("reserved bytes are not zero")
    origin_x, origin_y, origin_z, root_cell, distance, fps = _GEOMETRY.unpack(reader.take(_GEOMETRY.size))
    if not all(abs(x) <= _MAX_LENGTH for x in (origin_x, origin_y, origin_z)):
        raise _bad(f"an origin must lie within {_MAX_LENGTH:g} of 0")
    if not (_MIN_LENGTH <= root_cell <= _MAX_LENGTH and _MIN_LENGTH <= distance <= _MAX_LENGTH):
        raise _bad(f"root cell and reference distance must be {_MIN_LENGTH:g} to {_MAX_LENGTH:g}")
    if not _MIN_FPS <= fps <= _MAX_FPS:
        raise _bad(f"a frame rate must be {_MIN_FPS:g} to {_MAX_FPS:g}")
    background, *steps = (reader.floats(count) for count in (3, levels, features, 3 * slots, SCALINGS))
    usable = all(((part > 0) & (part <= _MAX_LENGTH)).all() for part in steps)
    if not usable or not ((background >= 0) & (background <= 1)).all():
        raise _bad(f"a background must be 0 to 1, and steps positive and at most {_MAX_LENGTH:g}")
    try:
        octree = Octree(np.array([origin_x, origin_y, origin_z]), root_cell, levels)
        cameras = tuple(_decode_camera(reader) for _ in range(camera_count))
    except (ValueError, InputError) as error:
        raise _bad(str(error)) from error
    reader.finish()
    position, feature, offset, scaling = steps
    return SceneHeader(
        octree, slots, bool(view_dependent), distance, position, feature, offset, scaling, background, fps, cameras
    )


def encode_weights(weights: AnchorWeights) -> bytes:
    """The WEIGHTS chunk.

    Raises:
        ValueError: a weight that is not exact in float16, or not finite.
    """
    parts = []
    for name in AnchorWeights.__slots__:
        exact: Float32 = getattr(weights, name)
        with np.errstate(over="ignore"):
            half = exact.astype("<f2")
        if not np.isfinite(half).all() or not np.array_equal(half.astype(np.float32), exact):
            raise ValueError(f"{name} must be rounded to float16 before it is sent")
        parts.append(half.tobytes())
    return b"".join(parts)


def decode_weights(data: bytes, header: SceneHeader) -> AnchorWeights:
    """The weights in a WEIGHTS chunk; BitstreamError `bad_weights` otherwise."""
    features, slots = len(header.feature_steps), header.gaussians_per_anchor
    inputs = features + VIEW_INPUTS * header.view_dependent
    shapes: tuple[tuple[int, ...], ...] = (
        (inputs, HIDDEN),
        (HIDDEN,),
        (HIDDEN, OUTPUTS * slots),
        (OUTPUTS * slots,),
        (FEATURE_LATENTS, features),
        (OFFSET_LATENTS, 3 * slots),
    )
    sizes = [math.prod(shape) for shape in shapes]
    if len(data) != 2 * sum(sizes):
        raise BitstreamError("bad_weights", f"{len(data)} bytes of weights where {2 * sum(sizes)} belong")
    values = np.frombuffer(data, "<f2").astype(np.float32)
    if not np.isfinite(values).all():
        raise BitstreamError("bad_weights", "a weight is not finite")
    starts = np.cumsum([0, *sizes])
    return AnchorWeights(*(values[a : a + n].reshape(s) for a, n, s in zip(starts, sizes, shapes, strict=False)))


def _encode_camera(camera: Camera) -> bytes:
    name = camera.name.encode()
    if len(name) > _MAX_NAME_BYTES:
        raise ValueError(f"camera name {camera.name!r} is longer than {_MAX_NAME_BYTES} bytes")
    pose = camera.world_to_camera[:3]
    doubles = np.concatenate([camera.intrinsics.ravel(), pose.ravel(), camera.distortion]).astype("<f8")
    return bytes([len(name)]) + name + _SIZE.pack(camera.width, camera.height) + doubles.tobytes()


def _decode_camera(reader: _HeaderReader) -> Camera:
    length = reader.take(1)[0]
    if length > _MAX_NAME_BYTES:
        raise ValueError(f"a camera name of {length} bytes is longer than {_MAX_NAME_BYTES}")
    name = reader.take(length).decode()
    width, height = _SIZE.unpack(reader.take(_SIZE.size))
    if max(width, height) > _MAX_PICTURE:
        raise ValueError(f"camera {name} claims pictures of {width}x{height}")
    doubles = np.frombuffer(reader.take(8 * _CAMERA_DOUBLES), "<f8").astype(np.float64)
    if not (np.abs(doubles) <= _MAX_CAMERA_NUMBER).all():  # so that no product in the checks that follow overflows
        raise ValueError(f"camera {name} holds numbers beyond {_MAX_CAMERA_NUMBER:g}")
    pose = np.eye(4)
    pose[:3] = doubles[9:21].reshape(3, 4)
    return Camera(name, doubles[:9].reshape(3, 3).copy(), pose, width, height, doubles[21:].copy())


def _bad(detail: str) -> BitstreamError:
    return BitstreamError("bad_scene_header", detail)


class _HeaderReader:
    """Bytes taken from the front, never more than there are."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, count: int) -> bytes:
        if self._at + count > len(self._data):
            raise _bad(f"the scene header ends after {len(self._data)} bytes, too early")
        self._at += count
        return self._data[self._at - count : self._at]

    def floats(self, count: int) -> Float32:
        return np.frombuffer(self.take(4 * count), "<f4").astype(np.float32)

    def finish(self) -> None:
        if self._at != len(self._data):
            raise _bad(f"{len(self._data) - self._at} bytes follow the scene header")
