"""Light on what the rays hit: soft shadows, ambient occlusion, highlights; and how far points are from a part."""

from __future__ import annotations

import math

import numba
import numpy as np

from streamlod.core.arrays import Bool, Float64, Int32, Int64
from streamlod.core.synthetic.shapes import (
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    FAR,
    PACKET,
    ROOM,
    SKY,
    Lamps,
    SolidParts,
    slab,
    to_local,
)

_OFFSET = 1e-4  # metres by which a ray to a lamp starts above its surface
AIR = 0.4  # metres above a surface up to which ambient occlusion looks
_REACHES = (0.04, 0.13, AIR)  # at which it samples the free space
_SPOT_EDGE = 0.25  # share of a spot light's cone, from its edge inwards, over which it fades
_WEIGHTS = (0.30, 0.38, 0.42)

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def _distance(kind: int, sx: float, sy: float, sz: float, x: float, y: float, z: float) -> float:
    """Signed distance from a local point to a part's surface, negative inside (the room is inside out)."""
    if kind == SKY:
        return FAR
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
def light(
    position: Float64,
    normal: Float64,
    part: Int32,
    towards: Float64,
    albedo: Float64,
    parts: SolidParts,
    lamps: Lamps,
    ambient: Float64,
    group: int,
    radiance: Float64,
) -> None:
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
        _sieve_occluders(position[start:stop], normal[start:stop], parts, lamps, near, found)
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
def _shade(
    position: Float64,
    normal: Float64,
    towards: Float64,
    albedo: Float64,
    gloss: float,
    lamps: Lamps,
    ambient: Float64,
    visible: Float64,
    radiance: Float64,
) -> None:
    """Light leaving one point: ambient, and diffuse and glossy reflection of each lamp. visible: as in `light`."""
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
        if lamps.cosine[k] > -1.0:
            inside = -(x * lamps.axis[k, 0] + y * lamps.axis[k, 1] + z * lamps.axis[k, 2]) - lamps.cosine[k]
            strength *= min(max(inside / (_SPOT_EDGE * (1.0 - lamps.cosine[k])), 0.0), 1.0)
        hx, hy, hz = x + towards[0], y + towards[1], z + towards[2]
        length = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-6)
        shine = max((hx * normal[0] + hy * normal[1] + hz * normal[2]) / length, 0.0) ** (40.0 + 160.0 * gloss)
        for c in range(3):
            radiance[c] += (
                lamps.colour[k, c] * strength * (facing * albedo[c] * (0.75 + 0.25 * open_share) + 3.0 * gloss * shine)
            )


@_jit
def _sieve_occluders(
    position: Float64, normal: Float64, parts: SolidParts, lamps: Lamps, near: Int32, found: Int64
) -> None:
    """Parts that can shade a packet of points from each lamp, and (last row) those close enough to occlude."""
    count, lamp_count = len(position), len(lamps.radius)
    cx, cy, cz, reach, ax, ay, az, air = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        cx, cy, cz = cx + position[i, 0] / count, cy + position[i, 1] / count, cz + position[i, 2] / count
        ax, ay, az = ax + normal[i, 0] / count, ay + normal[i, 1] / count, az + normal[i, 2] / count
    ax, ay, az = cx + AIR * ax, cy + AIR * ay, cz + AIR * az
    for i in range(count):
        reach = max(reach, (position[i, 0] - cx) ** 2 + (position[i, 1] - cy) ** 2 + (position[i, 2] - cz) ** 2)
        x, y, z = (
            position[i, 0] + AIR * normal[i, 0] - ax,
            position[i, 1] + AIR * normal[i, 1] - ay,
            position[i, 2] + AIR * normal[i, 2] - az,
        )
        air = max(air, x * x + y * y + z * z)
    reach, air = math.sqrt(reach), math.sqrt(air)
    for k in range(lamp_count + 1):
        found[k] = 0
    for p in range(len(parts.kind)):
        if parts.kind[p] == ROOM:
            near[lamp_count, found[lamp_count]] = p
            found[lamp_count] += 1
            continue
        x, y, z = parts.translation[p, 0] - cx, parts.translation[p, 1] - cy, parts.translation[p, 2] - cz
        ux, uy, uz = parts.translation[p, 0] - ax, parts.translation[p, 1] - ay, parts.translation[p, 2] - az
        if ux * ux + uy * uy + uz * uz < (parts.bound[p] + air + AIR) ** 2:
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
def _openness(position: Float64, normal: Float64, own: int, parts: SolidParts, near: Int32, found: int) -> float:
    """Ambient occlusion: the share of free space at three distances above the surface, 1 for an open one."""
    low, mid, high = _REACHES
    free_low, free_mid, free_high = _REACHES
    for c in range(found):
        p = near[c]
        if p == own and parts.kind[p] != ROOM:
            continue
        # everything that counts lies in the outermost sphere, which contains the inner ones
        x, y, z = (
            position[0] + high * normal[0] - parts.translation[p, 0],
            position[1] + high * normal[1] - parts.translation[p, 1],
            position[2] + high * normal[2] - parts.translation[p, 2],
        )
        if x * x + y * y + z * z > (parts.bound[p] + high) ** 2:
            continue
        x, y, z = to_local(parts, p, x, y, z)
        kind, size = parts.kind[p], parts.size[p]
        sx, sy, sz = _extent(kind, size)
        if kind != ROOM and max(abs(x) - sx, abs(y) - sy, abs(z) - sz) > high:
            continue
        u, v, w = to_local(parts, p, normal[0], normal[1], normal[2])
        free_high = min(free_high, _distance(kind, size[0], size[1], size[2], x, y, z))
        free_mid = min(
            free_mid,
            _distance(
                kind, size[0], size[1], size[2], x + (mid - high) * u, y + (mid - high) * v, z + (mid - high) * w
            ),
        )
        free_low = min(
            free_low,
            _distance(
                kind, size[0], size[1], size[2], x + (low - high) * u, y + (low - high) * v, z + (low - high) * w
            ),
        )
    share = 1.0 - _WEIGHTS[0] * (low - max(free_low, 0.0)) / low
    share *= 1.0 - _WEIGHTS[1] * (mid - max(free_mid, 0.0)) / mid
    return share * (1.0 - _WEIGHTS[2] * (high - max(free_high, 0.0)) / high)


@_jit
def _extent(kind: int, size: Float64) -> tuple[float, float, float]:
    """Half extents of a part's box in its own axes."""
    if kind == CAPSULE:
        return size[0], size[0], size[0] + size[1]
    if kind == CYLINDER:
        return size[0], size[0], size[1]
    return size[0], size[1], size[2]


@_jit
def _lamp_seen(
    position: Float64, normal: Float64, own: int, parts: SolidParts, lamps: Lamps, k: int, near: Int32, found: int
) -> float:
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
        ux, uy, uz = to_local(parts, p, ux, uy, uz)
        dx, dy, dz = to_local(parts, p, x, y, z)
        sx, sy, sz = _extent(parts.kind[p], parts.size[p])
        margin = width * high  # of the cone at its widest here
        x0, x1 = slab(ux, dx, sx + margin)
        y0, y1 = slab(uy, dy, sy + margin)
        z0, z1 = slab(uz, dz, sz + margin)
        low, high = max(low, x0, y0, z0), min(high, x1, y1, z1)
        if low >= high:
            continue
        middle = 0.5 * (low + high)
        kind, size = parts.kind[p], parts.size[p]
        clear = _distance(kind, size[0], size[1], size[2], ux + middle * dx, uy + middle * dy, uz + middle * dz)
        if clear - 0.5 * (high - low) > width * high:
            continue
        seen *= _unhidden(parts.kind[p], parts.size[p], (ux, uy, uz), (dx, dy, dz), width, low, high)
        if seen < 0.004:
            return 0.0
    return seen


@_jit
def _unhidden(
    kind: int,
    size: Float64,
    o: tuple[float, float, float],
    d: tuple[float, float, float],
    width: float,
    low: float,
    high: float,
) -> float:
    """Share of the lamp that one convex part leaves visible; see `_lamp_seen`.

    Args:
        o, d: start and direction of the cone's axis in the part's axes. width: radius of the cone at 1 m.
        low, high: part of the axis to search, metres.
    """
    golden = 0.6180339887498949
    least = 1.0
    a, b = high - golden * (high - low), low + golden * (high - low)
    fa = _distance(kind, size[0], size[1], size[2], o[0] + a * d[0], o[1] + a * d[1], o[2] + a * d[2]) / (width * a)
    fb = _distance(kind, size[0], size[1], size[2], o[0] + b * d[0], o[1] + b * d[1], o[2] + b * d[2]) / (width * b)
    for _ in range(7):
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
def touched(
    eye: Float64,
    centre: Float64,
    reach: Float64,
    axis: Float64,
    angle: Float64,
    far: Float64,
    air: Float64,
    air_reach: Float64,
    parts: SolidParts,
    first: int,
    lamps: Lamps,
    out: Bool,
) -> None:
    """Which of M packets the parts from number `first` on can change: by covering, shading or occluding; [M] bool."""
    for m in range(len(reach)):
        out[m] = False
        for p in range(first, len(parts.kind)):
            bound, place = parts.bound[p], parts.translation[p]
            x, y, z = place[0] - eye[0], place[1] - eye[1], place[2] - eye[2]
            away = math.sqrt(x * x + y * y + z * z)
            if away - bound < far[m]:
                off = math.acos(min(max((x * axis[m, 0] + y * axis[m, 1] + z * axis[m, 2]) / away, -1.0), 1.0))
                if bound >= away or off <= angle[m] + math.asin(bound / away) + 1e-6:
                    out[m] = True
                    break
            x, y, z = place[0] - centre[m, 0], place[1] - centre[m, 1], place[2] - centre[m, 2]
            ux, uy, uz = place[0] - air[m, 0], place[1] - air[m, 1], place[2] - air[m, 2]
            out[m] = ux * ux + uy * uy + uz * uz < (bound + air_reach[m] + AIR) ** 2
            for k in range(len(lamps.radius)):
                lx, ly, lz = (
                    lamps.position[k, 0] - centre[m, 0],
                    lamps.position[k, 1] - centre[m, 1],
                    lamps.position[k, 2] - centre[m, 2],
                )
                t = min(max((x * lx + y * ly + z * lz) / (lx * lx + ly * ly + lz * lz), 0.0), 1.0)
                gap = (x - t * lx) ** 2 + (y - t * ly) ** 2 + (z - t * lz) ** 2
                out[m] |= gap < (bound + reach[m] + t * lamps.radius[k]) ** 2
            if out[m]:
                break
