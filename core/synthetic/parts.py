"""The vocabulary of the synthetic scene: a part is an analytic shape with a texture and a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Float64, Int32
from streamlod.core.synthetic.shapes import BOX, CAPSULE, CYLINDER, ELLIPSOID, ROOM, SKY, Lamps, SolidParts
from streamlod.core.synthetic.textures.numbers import GLOW, PLAIN, SCREEN, VIEW

Vector = tuple[float, float, float]
_IDENTITY = np.eye(3)
_THIN = 0.0125  # metres of half thickness below which a box's shadow does not show


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One rigid shape.

    Attributes:
        kind, size: as in `shapes.SolidParts`.
        place: [3] metres; rotation: [3,3] part to world.
        material: number of its texture (`textures.numbers`); tint: display colour; seed: of the texture.
        gloss: strength of highlights; mirror: share of light reflected like a mirror.
    """

    kind: int
    size: Vector
    place: Float64
    material: int = PLAIN
    tint: Vector = (0.7, 0.7, 0.7)
    rotation: Float64 | None = None
    seed: int = 0
    gloss: float = 0.02
    mirror: float = 0.0

    @property
    def casts(self) -> bool:
        """Whether it throws shadows: no enclosure, nothing that glows, nothing as thin as a picture on the wall."""
        solid = self.kind not in (ROOM, SKY, BOX) or (self.kind == BOX and min(self.size) >= _THIN)
        return solid and self.material not in (GLOW, SCREEN, VIEW)

    @property
    def bound(self) -> float:
        """Radius of the enclosing sphere round the part's origin."""
        if self.kind in (ROOM, SKY):
            return math.inf
        if self.kind == BOX:
            return math.hypot(*self.size)
        if self.kind == ELLIPSOID:
            return max(self.size)
        radius, half = self.size[0], self.size[1]
        return radius + half if self.kind == CAPSULE else math.hypot(radius, half)


@dataclass(frozen=True, slots=True, eq=False)
class SceneArrays:
    """All parts at one instant, as arrays: `solid` for ray casting, the rest for shading; one row for each part.

    `material`, `seed` are [P] int32, `size` and `tint` [P,3], `mirror` [P].
    """

    solid: SolidParts
    material: Int32
    tint: Float64
    seed: Int32
    mirror: Float64


def assemble(parts: list[Part]) -> SceneArrays:
    """The arrays of `parts`, in their order."""
    rotations = [part.rotation if part.rotation is not None else _IDENTITY for part in parts]
    solid = SolidParts(
        kind=np.array([part.kind for part in parts], np.int32),
        size=np.array([part.size for part in parts], np.float64),
        rotation=np.array(rotations, np.float64),
        translation=np.array([part.place for part in parts], np.float64),
        bound=np.array([part.bound for part in parts], np.float64),
        casts=np.array([part.casts for part in parts]),
        gloss=np.array([part.gloss for part in parts], np.float64),
    )
    return SceneArrays(
        solid,
        material=np.array([part.material for part in parts], np.int32),
        tint=np.array([part.tint for part in parts], np.float64),
        seed=np.array([part.seed for part in parts], np.int32),
        mirror=np.array([part.mirror for part in parts], np.float64),
    )


def turn(axis: str, angle: float) -> Float64:
    """[3,3] rotation by `angle` radians about ``x``, ``y`` or ``z``."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = c, -s, s, c
    return rotation


def box(place: Vector, half: Vector, material: int, tint: Vector, **more: object) -> Part:
    """A box with half extents `half`, its middle at `place`."""
    return Part(BOX, half, np.array(place), material, tint, **more)  # type: ignore[arg-type]


def ball(place: Vector, radii: Vector, material: int, tint: Vector, **more: object) -> Part:
    """An ellipsoid."""
    return Part(ELLIPSOID, radii, np.array(place), material, tint, **more)  # type: ignore[arg-type]


def tube(place: Vector, radius: float, half: float, material: int, tint: Vector, **more: object) -> Part:
    """An upright cylinder."""
    return Part(CYLINDER, (radius, half, half), np.array(place), material, tint, **more)  # type: ignore[arg-type]


def limb(start: Float64, end: Float64, radius: float, material: int, tint: Vector, **more: object) -> Part:
    """A capsule from `start` to `end`; its texture does not twist as long as it is not upright to the y axis."""
    along = end - start
    length = float(np.linalg.norm(along))
    axis = along / length
    side = np.cross([0.0, 1.0, 0.0], axis)
    side /= np.linalg.norm(side)
    rotation = np.stack([side, np.cross(axis, side), axis], axis=1)
    size = (radius, length / 2, radius)
    return Part(CAPSULE, size, (start + end) / 2, material, tint, rotation=rotation, **more)  # type: ignore[arg-type]


def shifted(parts: list[Part], by: Vector) -> list[Part]:
    """`parts` moved by metres."""
    return [replace(part, place=part.place + np.array(by)) for part in parts]


def turned(parts: list[Part], about: Vector, angle: float) -> list[Part]:
    """`parts` turned together by `angle` radians about the upright line through the point `about`."""
    rotation, centre = turn("z", angle), np.array(about)
    return [
        replace(
            part,
            place=rotation @ (part.place - centre) + centre,
            rotation=rotation if part.rotation is None else rotation @ part.rotation,
        )
        for part in parts
    ]


@dataclass(frozen=True, slots=True)
class Lamp:
    """One lamp, as in `shapes.Lamps`; `spot` is what a spot light points at and half its cone's angle in radians."""

    position: Vector
    radius: float
    colour: Vector
    spot: tuple[Vector, float] | None = None


def lamps(*some: Lamp) -> Lamps:
    """The arrays of `some` lamps, in their order."""
    axes, cosines = [], []
    for lamp in some:
        target, angle = lamp.spot or ((0.0, 0.0, 0.0), math.pi)
        axis = np.subtract(target, lamp.position)
        axes.append(axis / max(float(np.linalg.norm(axis)), 1e-12))
        cosines.append(math.cos(angle) if lamp.spot else -2.0)
    return Lamps(
        position=np.array([lamp.position for lamp in some], np.float64),
        radius=np.array([lamp.radius for lamp in some], np.float64),
        colour=np.array([lamp.colour for lamp in some], np.float64),
        axis=np.array(axes),
        cosine=np.array(cosines),
    )
