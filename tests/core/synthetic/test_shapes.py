"""The compiled geometry against itself and against plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.synthetic.casting import cast
from streamlod.core.synthetic.lighting import _distance
from streamlod.core.synthetic.parts import Part, assemble, turn
from streamlod.core.synthetic.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID, ROOM, SolidParts

KINDS = {
    "box": (BOX, (0.3, 0.5, 0.2)),
    "ball": (ELLIPSOID, (0.4, 0.4, 0.4)),
    "ellipsoid": (ELLIPSOID, (0.5, 0.2, 0.3)),
    "capsule": (CAPSULE, (0.2, 0.4, 0.2)),
    "cylinder": (CYLINDER, (0.3, 0.4, 0.4)),
}


def distances(points: Float64, parts: SolidParts, p: int) -> Float64:
    """Signed distances [N] from world `points` [N,3] to the surface of part `p`."""
    local = (points - parts.translation[p]) @ parts.rotation[p]
    return np.array([_distance(parts.kind[p], *parts.size[p], *point) for point in local])


@pytest.mark.parametrize("name", KINDS)
def test_rays_end_on_the_surface_and_nothing_lies_before_it(name: str) -> None:
    generator = np.random.default_rng(3)
    kind, size = KINDS[name]
    rotation = turn("z", 0.7) @ turn("x", -1.1)
    room = Part(ROOM, (3.0, 3.0, 3.0), np.zeros(3))
    scene = assemble([room, Part(kind, size, np.array([0.2, -0.1, 0.3]), rotation=rotation)])
    origins = generator.normal(size=(2000, 3))
    origins *= 2.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = generator.normal(scale=0.3, size=(2000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance, part = np.empty(2000), np.empty(2000, np.int32)
    point, normal = np.empty((2000, 3)), np.empty((2000, 3))
    cast(origins, directions, scene.solid, distance, part, point, normal)
    hit = part == 1
    assert 200 < hit.sum() < 2000
    away = distances(origins + distance[:, None] * directions, scene.solid, 1)
    assert np.abs(away[hit]).max() < 1e-9
    assert (away[~hit] > 0).all()
    assert np.allclose(np.linalg.norm(normal, axis=1), 1)
    assert (np.einsum("ni,ni->n", directions @ rotation, normal)[hit] < 1e-9).all()  # outward normals face the ray
    for share in (0.2, 0.5, 0.8, 0.97):
        assert (distances(origins + share * distance[:, None] * directions, scene.solid, 1) > 0).all()


def test_distances_are_euclidean() -> None:
    scene = assemble([Part(BOX, (1.0, 1.0, 1.0), np.zeros(3)), Part(CAPSULE, (0.5, 1.0, 0.5), np.zeros(3))])
    points = np.array([[2.0, 0.0, 0.0], [2.0, 2.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.0]])
    assert np.allclose(distances(points, scene.solid, 0), [1.0, np.sqrt(2.0), -1.0, 2.0])
    assert np.allclose(distances(points, scene.solid, 1), [1.5, np.sqrt(8.0) - 0.5, -0.5, 1.5])
