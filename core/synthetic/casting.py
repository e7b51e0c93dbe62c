"""Casting rays at rigid analytic parts: where each ray of a packet hits first.

Rays come in packets of neighbours; each packet first sieves out the parts that none of its rays can meet.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from streamlod.core.arrays import Float64, Int32
from streamlod.core.synthetic.shapes import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    FAR,
    PACKET,
    ROOM,
    SKY,
    SKY_DISTANCE,
    SolidParts,
    slab,
    to_local,
)

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def _quadratic(a: float, b: float, c: float) -> float:
    """Smaller root of a t^2 + 2 b t + c, or far."""
    root = b * b - a * c
    if root < 0.0 or a < 1e-12:
        return FAR
    return (-b - math.sqrt(root)) / a


@_jit
def _meet(
    kind: int, sx: float, sy: float, sz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """Distance along a local ray to a part's surface, or far; rays start outside (inside for the room)."""
    if kind == SKY:
        return SKY_DISTANCE
    if kind in (BOX, ROOM):
        x0, x1 = slab(ox, dx, sx)
        y0, y1 = slab(oy, dy, sy)
        z0, z1 = slab(oz, dz, sz)
        enter, leave = max(x0, y0, z0), min(x1, y1, z1)
        if kind == ROOM:
            return leave
        return enter if enter <= leave and enter > 0.0 else FAR
    if kind == ELLIPSOID:
        ux, uy, uz, vx, vy, vz = ox / sx, oy / sy, oz / sz, dx / sx, dy / sy, dz / sz
        t = _quadratic(vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz, ux * ux + uy * uy + uz * uz - 1.0)
        return t if t > 0.0 else FAR
    radius, half = sx, sy
    t = _quadratic(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - radius * radius)
    if t > 0.0 and abs(oz + t * dz) <= half:
        return t
    best = FAR
    for end in (-half, half):
        if kind == CAPSULE:
            w = oz - end
            t = _quadratic(1.0, ox * dx + oy * dy + w * dz, ox * ox + oy * oy + w * w - radius * radius)
            if 0.0 < t < best:
                best = t
        elif abs(dz) > 1e-12:
            t = (end - oz) / dz
            x, y = ox + t * dx, oy + t * dy
            if 0.0 < t < best and x * x + y * y <= radius * radius:
                best = t
    return best


@_jit
def _normal(kind: int, sx: float, sy: float, sz: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Outward unit normal at a local surface point (inward for the room and the sky)."""
    if kind == SKY:
        length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
        return -x / length, -y / length, -z / length
    if kind in (BOX, ROOM):
        a, b, c = abs(x) - sx, abs(y) - sy, abs(z) - sz
        sign = -1.0 if kind == ROOM else 1.0
        if a >= b and a >= c:
            return math.copysign(sign, sign * x), 0.0, 0.0
        if b >= c:
            return 0.0, math.copysign(sign, sign * y), 0.0
        return 0.0, 0.0, math.copysign(sign, sign * z)
    if kind == ELLIPSOID:
        nx, ny, nz = x / (sx * sx), y / (sy * sy), z / (sz * sz)
    elif kind == CYLINDER and abs(z) - sy > math.sqrt(x * x + y * y) - sx:
        nx, ny, nz = 0.0, 0.0, z
    else:
        nx, ny, nz = x, y, z - min(max(z, -sy), sy)
    length = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
    return nx / length, ny / length, nz / length


@_jit
def cast(
    origins: Float64,
    directions: Float64,
    parts: SolidParts,
    distance: Float64,
    part: Int32,
    point: Float64,
    normal: Float64,
) -> None:
    """Nearest hit of N rays (unit `directions` [N,3]): distance [N], part [N], local point and local normal [N,3].

    The scene is closed: every ray that starts in the room, or under the sky, hits something.
    """
    count, total = len(origins), len(parts.kind)
    near = np.empty(total, np.int32)
    for start in range(0, count, PACKET):
        stop = min(start + PACKET, count)
        found = _sieve_cone(origins[start:stop], directions[start:stop], parts, near)
        for i in range(start, stop):
            best, which = FAR, 0
            for c in range(found):
                p = near[c]
                ox, oy, oz = (
                    origins[i, 0] - parts.translation[p, 0],
                    origins[i, 1] - parts.translation[p, 1],
                    origins[i, 2] - parts.translation[p, 2],
                )
                if parts.kind[p] != ROOM:
                    along = ox * directions[i, 0] + oy * directions[i, 1] + oz * directions[i, 2]
                    if ox * ox + oy * oy + oz * oz - along * along > parts.bound[p] ** 2:
                        continue
                ox, oy, oz = to_local(parts, p, ox, oy, oz)
                dx, dy, dz = to_local(parts, p, directions[i, 0], directions[i, 1], directions[i, 2])
                size = parts.size[p]
                t = _meet(parts.kind[p], size[0], size[1], size[2], ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, which = t, p
                    point[i, 0], point[i, 1], point[i, 2] = ox + t * dx, oy + t * dy, oz + t * dz
            distance[i], part[i] = best, which
            size = parts.size[which]
            normal[i, 0], normal[i, 1], normal[i, 2] = _normal(
                parts.kind[which], size[0], size[1], size[2], point[i, 0], point[i, 1], point[i, 2]
            )


@_jit
def _sieve_cone(origins: Float64, directions: Float64, parts: SolidParts, near: Int32) -> int:
    """Parts that a packet of rays may meet: those whose bounding sphere reaches into the packet's cone."""
    count = len(origins)
    ax, ay, az, cx, cy, cz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        ax, ay, az = ax + directions[i, 0], ay + directions[i, 1], az + directions[i, 2]
        cx, cy, cz = cx + origins[i, 0], cy + origins[i, 1], cz + origins[i, 2]
    length = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-12)
    ax, ay, az, cx, cy, cz = ax / length, ay / length, az / length, cx / count, cy / count, cz / count
    spread, reach = 1.0, 0.0
    for i in range(count):
        spread = min(spread, ax * directions[i, 0] + ay * directions[i, 1] + az * directions[i, 2])
        reach = max(reach, (origins[i, 0] - cx) ** 2 + (origins[i, 1] - cy) ** 2 + (origins[i, 2] - cz) ** 2)
    angle, reach, found = math.acos(min(max(spread, -1.0), 1.0)), math.sqrt(reach), 0
    for p in range(len(parts.kind)):
        x, y, z = parts.translation[p, 0] - cx, parts.translation[p, 1] - cy, parts.translation[p, 2] - cz
        away, radius = math.sqrt(x * x + y * y + z * z), parts.bound[p] + reach
        hit = parts.kind[p] == ROOM or radius >= away
        if not hit:
            off = math.acos(min(max((x * ax + y * ay + z * az) / away, -1.0), 1.0))
            hit = off <= angle + math.asin(radius / away) + 1e-6
        if hit:
            near[found] = p
            found += 1
    return found


@_jit
def balls_round(points: Float64, per_packet: int, centre: Float64, reach: Float64) -> None:
    """A sphere round each packet of `per_packet` of the `points` [N,3]: centre [M,3] and radius [M]."""
    for m in range(len(reach)):
        start, stop = m * per_packet, min((m + 1) * per_packet, len(points))
        square = 0.0
        for k in range(3):
            centre[m, k] = 0.0
            for i in range(start, stop):
                centre[m, k] += points[i, k] / (stop - start)
        for i in range(start, stop):
            x, y, z = points[i, 0] - centre[m, 0], points[i, 1] - centre[m, 1], points[i, 2] - centre[m, 2]
            square = max(square, x * x + y * y + z * z)
        reach[m] = math.sqrt(square)


@_jit
def cones_round(directions: Float64, per_packet: int, axis: Float64, angle: Float64) -> None:
    """A cone round each packet of `per_packet` of the unit `directions` [N,3]: axis [M,3] and half angle [M]."""
    for m in range(len(angle)):
        start, stop = m * per_packet, min((m + 1) * per_packet, len(directions))
        for k in range(3):
            axis[m, k] = 0.0
            for i in range(start, stop):
                axis[m, k] += directions[i, k]
        axis[m] /= max(math.sqrt(axis[m, 0] ** 2 + axis[m, 1] ** 2 + axis[m, 2] ** 2), 1e-12)
        spread = 1.0
        for i in range(start, stop):
            cosine = 0.0
            for k in range(3):
                cosine += axis[m, k] * directions[i, k]
            spread = min(spread, cosine)
        angle[m] = math.acos(min(max(spread, -1.0), 1.0))
