"""Casting rays at rigid analytic parts, and lighting what they hit: the compiled half of the synthetic scene.

Everything in this file is compiled together and calls nothing compiled elsewhere, so that the on-disk cache of compiled
code is renewed whenever a line here changes. Rays come in packets of neighbours; each packet first sieves out the parts
that none of its rays can meet.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from core.arrays import Bool, Float64, Int32

ROOM, BOX, ELLIPSOID, CAPSULE, CYLINDER = 0, 1, 2, 3, 4
PACKET = 128  # neighbouring rays that share one list of candidate parts
_FAR = 1e9
_OFFSET = 1e-4  # metres by which a secondary ray starts above its surface
_REACHES = (0.04, 0.13, 0.4)  # metres at which ambient occlusion samples the free space above a surface
_WEIGHTS = (0.30, 0.38, 0.42)


class Parts(NamedTuple):
    """P rigid parts of the scene at one instant.

    Attributes:
        kind: [P] int32; size: [P,3] metres: half extents (ROOM, BOX), radii (ELLIPSOID), or radius and half length along z.
        rotation: [P,3,3], translation: [P,3] part to world, metres.
        bound: [P] radius of a sphere round the part's origin that encloses it; infinite for the room.
        casts: [P] bool, whether the part throws shadows.
        gloss: [P] strength of its highlights.
    """

    kind: Int32
    size: Float64
    rotation: Float64
    translation: Float64
    bound: Float64
    casts: Bool
    gloss: Float64


class Lamps(NamedTuple):
    """K lamps: position [K,3] and radius [K] in metres (a larger lamp throws softer shadows), colour [K,3] radiant."""

    position: Float64
    radius: Float64
    colour: Float64


_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def _to_local(parts, i, x, y, z):
    rotation = parts.rotation[i]
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@_jit
def _slab(o, d, half):
    """Distances at which a ray enters and leaves |coordinate| <= half."""
    if abs(d) < 1e-12:
        return (-_FAR, _FAR) if abs(o) <= half else (_FAR, -_FAR)
    a, b = (-half - o) / d, (half - o) / d
    return (a, b) if a < b else (b, a)


@_jit
def _quadratic(a, b, c):
    """Smaller root of a t^2 + 2 b t + c, or far."""
    root = b * b - a * c
    if root < 0.0 or a < 1e-12:
        return _FAR
    return (-b - math.sqrt(root)) / a


@_jit
def _meet(kind, sx, sy, sz, ox, oy, oz, dx, dy, dz):
    """Distance along a local ray to a part's surface, or far; rays start outside (inside for the room)."""
    if kind == BOX or kind == ROOM:
        x0, x1 = _slab(ox, dx, sx)
        y0, y1 = _slab(oy, dy, sy)
        z0, z1 = _slab(oz, dz, sz)
        enter, leave = max(x0, y0, z0), min(x1, y1, z1)
        if kind == ROOM:
            return leave
        return enter if enter <= leave and enter > 0.0 else _FAR
    if kind == ELLIPSOID:
        ux, uy, uz, vx, vy, vz = ox / sx, oy / sy, oz / sz, dx / sx, dy / sy, dz / sz
        t = _quadratic(vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz, ux * ux + uy * uy + uz * uz - 1.0)
        return t if t > 0.0 else _FAR
    radius, half = sx, sy
    t = _quadratic(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - radius * radius)
    if t > 0.0 and abs(oz + t * dz) <= half:
        return t
    best = _FAR
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
def _distance(kind, sx, sy, sz, x, y, z):
    """Signed distance from a local point to a part's surface, negative inside (the room is inside out)."""
    if kind == ROOM:
        return min(sx - abs(x), sy - abs(y), sz - abs(z))
    if kind == ELLIPSOID:
        near = math.sqrt((x / sx) ** 2 + (y / sy) ** 2 + (z / sz) ** 2)
        slope = math.sqrt((x / (sx * sx)) ** 2 + (y / (sy * sy)) ** 2 + (z / (sz * sz)) ** 2)
        return near * (near - 1.0) / max(slope, 1e-9)
    if kind == CAPSULE:
        w = z - min(max(z, -sy), sy)
        return math.sqrt(x * x + y * y + w * w) - sx
    if kind == CYLINDER:
        a, b = math.sqrt(x * x + y * y) - sx, abs(z) - sy
        return math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2) + min(max(a, b), 0.0)
    a, b, c = abs(x) - sx, abs(y) - sy, abs(z) - sz
    return math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2) + min(max(a, b, c), 0.0)


@_jit
def _normal(kind, sx, sy, sz, x, y, z):
    """Outward unit normal at a local surface point (inward for the room)."""
    if kind == BOX or kind == ROOM:
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
def cast(origins, directions, parts, distance, part, point, normal):
    """Nearest hit of N rays (unit `directions` [N,3]): distance [N], part [N], local point and local normal [N,3].

    The scene is closed: every ray that starts in the room hits something.
    """
    count, total = len(origins), len(parts.kind)
    near = np.empty(total, np.int32)
    for start in range(0, count, PACKET):
        stop = min(start + PACKET, count)
        found = _sieve_cone(origins[start:stop], directions[start:stop], parts, near)
        for i in range(start, stop):
            best, which = _FAR, 0
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
                ox, oy, oz = _to_local(parts, p, ox, oy, oz)
                dx, dy, dz = _to_local(parts, p, directions[i, 0], directions[i, 1], directions[i, 2])
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
def _sieve_cone(origins, directions, parts, near):
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
def light(position, normal, part, towards, albedo, parts, lamps, ambient, group, radiance):
    """Light leaving N surface points towards the eye: radiance [N,3].

    Args:
        position, normal: [N,3] world, outward. part: [N]. towards: [N,3] unit vectors to the eye.
        albedo: [N,4] linear reflectance and, in the last column, the share that glows by itself.
        ambient: [3] light from everywhere. group: samples of one pixel; where they agree on the surface, one stands for
            all in the shadow and occlusion tests.
    """
    count, lamp_count = len(position), len(lamps.radius)
    near = np.empty((lamp_count + 1, len(parts.kind)), np.int32)
    found = np.zeros(lamp_count + 1, np.int64)
    visible = np.ones(lamp_count + 1)
    for start in range(0, count, PACKET):
        stop = min(start + PACKET, count)
        _sieve_occluders(position[start:stop], parts, lamps, near, found)
        for first in range(start, stop, group):
            together = True
            for i in range(first + 1, min(first + group, stop)):
                turn = 0.0
                for k in range(3):
                    turn += normal[i, k] * normal[first, k]
                together = together and part[i] == part[first] and turn > 0.95
            for i in range(first, min(first + group, stop)):
                if i == first or not together:
                    visible[lamp_count] = _openness(
                        position[i], normal[i], part[i], parts, near[lamp_count], found[lamp_count]
                    )
                    for k in range(lamp_count):
                        visible[k] = _lamp_seen(position[i], normal[i], part[i], parts, lamps, k, near[k], found[k])
                _shade(
                    position[i],
                    normal[i],
                    towards[i],
                    albedo[i],
                    parts.gloss[part[i]],
                    lamps,
                    ambient,
                    visible,
                    radiance[i],
                )


@_jit
def _shade(position, normal, towards, albedo, gloss, lamps, ambient, visible, radiance):
    lamp_count = len(lamps.radius)
    open_share = visible[lamp_count]
    for c in range(3):
        radiance[c] = albedo[c] * (albedo[3] + ambient[c] * open_share * (0.8 + 0.2 * normal[2]))
    for k in range(lamp_count):
        if visible[k] <= 0.0:
            continue
        x, y, z = (
            lamps.position[k, 0] - position[0],
            lamps.position[k, 1] - position[1],
            lamps.position[k, 2] - position[2],
        )
        away = max(math.sqrt(x * x + y * y + z * z), 1e-6)
        x, y, z = x / away, y / away, z / away
        facing = max(x * normal[0] + y * normal[1] + z * normal[2], 0.0)
        strength = visible[k] / (0.6 + away * away)
        hx, hy, hz = x + towards[0], y + towards[1], z + towards[2]
        length = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-6)
        shine = max((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 0.0) ** (40.0 + 160.0 * gloss)
        for c in range(3):
            radiance[c] += (
                lamps.colour[k, c] * strength * (facing * albedo[c] * (0.75 + 0.25 * open_share) + 3.0 * gloss * shine)
            )


@_jit
def _sieve_occluders(position, parts, lamps, near, found):
    """Parts that can shade a packet of points from each lamp, and (last row) those close enough to occlude."""
    count, lamp_count = len(position), len(lamps.radius)
    cx, cy, cz, reach = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        cx, cy, cz = cx + position[i, 0] / count, cy + position[i, 1] / count, cz + position[i, 2] / count
    for i in range(count):
        reach = max(reach, (position[i, 0] - cx) ** 2 + (position[i, 1] - cy) ** 2 + (position[i, 2] - cz) ** 2)
    reach = math.sqrt(reach)
    for k in range(lamp_count + 1):
        found[k] = 0
    for p in range(len(parts.kind)):
        if parts.kind[p] == ROOM:
            near[lamp_count, found[lamp_count]] = p
            found[lamp_count] += 1
            continue
        x, y, z = parts.translation[p, 0] - cx, parts.translation[p, 1] - cy, parts.translation[p, 2] - cz
        square = x * x + y * y + z * z
        if square < (parts.bound[p] + reach + 2.0 * _REACHES[2]) ** 2:
            near[lamp_count, found[lamp_count]] = p
            found[lamp_count] += 1
        if not parts.casts[p]:
            continue
        for k in range(lamp_count):
            lx, ly, lz = lamps.position[k, 0] - cx, lamps.position[k, 1] - cy, lamps.position[k, 2] - cz
            t = min(max((x * lx + y * ly + z * lz) / (lx * lx + ly * ly + lz * lz), 0.0), 1.0)
            gap = (x - t * lx) ** 2 + (y - t * ly) ** 2 + (z - t * lz) ** 2
            if gap < (parts.bound[p] + reach + lamps.radius[k]) ** 2:
                near[k, found[k]] = p
                found[k] += 1


@_jit
def _openness(position, normal, own, parts, near, found):
    """Ambient occlusion: the share of free space at three distances above the surface, 1 for an open one."""
    share = 1.0
    for step in range(3):
        reach = _REACHES[step]
        x, y, z = position[0] + reach * normal[0], position[1] + reach * normal[1], position[2] + reach * normal[2]
        free = reach
        for c in range(found):
            p = near[c]
            if p == own and parts.kind[p] != ROOM:
                continue
            ux, uy, uz = x - parts.translation[p, 0], y - parts.translation[p, 1], z - parts.translation[p, 2]
            if ux * ux + uy * uy + uz * uz > (parts.bound[p] + reach) ** 2:
                continue
            ux, uy, uz = _to_local(parts, p, ux, uy, uz)
            size = parts.size[p]
            free = min(free, _distance(parts.kind[p], size[0], size[1], size[2], ux, uy, uz))
        share *= 1.0 - _WEIGHTS[step] * (reach - max(free, 0.0)) / reach
    return share


@_jit
def _lamp_seen(position, normal, own, parts, lamps, k, near, found):
    """Share of a round lamp that a point sees, 0 to 1.

    A convex part hides the more of the lamp the deeper the cone from point to lamp is cut: the least value of (signed
    distance / cone radius) along the axis, which is quasi-convex, so a golden-section search finds it.
    """
    ox, oy, oz = (
        position[0] + _OFFSET * normal[0],
        position[1] + _OFFSET * normal[1],
        position[2] + _OFFSET * normal[2],
    )
    x, y, z = lamps.position[k, 0] - ox, lamps.position[k, 1] - oy, lamps.position[k, 2] - oz
    away = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    x, y, z = x / away, y / away, z / away
    if x * normal[0] + y * normal[1] + z * normal[2] <= 0.0:
        return 0.0
    width, seen = lamps.radius[k] / away, 1.0
    for c in range(found):
        p = near[c]
        if p == own:
            continue
        ux, uy, uz = ox - parts.translation[p, 0], oy - parts.translation[p, 1], oz - parts.translation[p, 2]
        along = -(ux * x + uy * y + uz * z)
        gap = math.sqrt(max(ux * ux + uy * uy + uz * uz - along * along, 0.0))
        low, high = max(along - parts.bound[p], 1e-4), min(along + parts.bound[p], away)
        if low >= high or gap > parts.bound[p] + width * high:
            continue
        ux, uy, uz = _to_local(parts, p, ux, uy, uz)
        dx, dy, dz = _to_local(parts, p, x, y, z)
        seen *= _unhidden(parts.kind[p], parts.size[p], (ux, uy, uz), (dx, dy, dz), width, low, high)
        if seen < 0.004:
            return 0.0
    return seen


@_jit
def _unhidden(kind, size, o, d, width, low, high):
    golden = 0.6180339887498949
    least = 1.0
    a, b = high - golden * (high - low), low + golden * (high - low)
    fa = _distance(kind, size[0], size[1], size[2], o[0] + a * d[0], o[1] + a * d[1], o[2] + a * d[2]) / (width * a)
    fb = _distance(kind, size[0], size[1], size[2], o[0] + b * d[0], o[1] + b * d[1], o[2] + b * d[2]) / (width * b)
    for _ in range(11):
        least = min(least, fa, fb)
        if least <= -1.0:
            return 0.0
        if fa < fb:
            high, b, fb = b, a, fa
            a = high - golden * (high - low)
            fa = _distance(kind, size[0], size[1], size[2], o[0] + a * d[0], o[1] + a * d[1], o[2] + a * d[2]) / (
                width * a
            )
        else:
            low, a, fa = a, b, fb
            b = low + golden * (high - low)
            fb = _distance(kind, size[0], size[1], size[2], o[0] + b * d[0], o[1] + b * d[1], o[2] + b * d[2]) / (
                width * b
            )
    share = 0.5 + 0.5 * min(least, fa, fb)
    return share * share * (3.0 - 2.0 * share)


@_jit
def distances(points, parts, p, out):
    """Signed distance [N] in metres from world `points` [N,3] to part `p`."""
    size = parts.size[p]
    for i in range(len(points)):
        x, y, z = _to_local(
            parts,
            p,
            points[i, 0] - parts.translation[p, 0],
            points[i, 1] - parts.translation[p, 1],
            points[i, 2] - parts.translation[p, 2],
        )
        out[i] = _distance(parts.kind[p], size[0], size[1], size[2], x, y, z)
