"""Pictures and ground truth of the synthetic scene, one camera at a time."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Bool, Float32, Float64, Int32, Int64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.synthetic.casting import balls_round, cast, cones_round
from streamlod.core.synthetic.kind import Kind
from streamlod.core.synthetic.lighting import AIR, light, touched
from streamlod.core.synthetic.parts import SceneArrays, assemble
from streamlod.core.synthetic.shapes import FAR
from streamlod.core.synthetic.spec import SyntheticSpec, cameras, exposures
from streamlod.core.synthetic.textures.paint import paint

_T = TypeVar("_T", bound=np.generic)
_SPAN = 32  # neighbouring pixels that are rendered again together, or not
_BATCH = 4096  # pixels that one thread renders at a time
_MOVED = 2e-4  # metres a frame below which a surface counts as still
_SAMPLES = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
_CENTRE = np.array([[0.5, 0.5]])
_SKY = 1e-3 * FAR  # metres; what lies deeper is sky


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """Truth at each pixel's centre of one camera's picture at one instant.

    Attributes:
        depth: [H,W] float32 metres along the camera's z axis, infinite in the sky.
        motion: [H,W,3] float32 metres that the surface point moved in the world since the frame before.
        moving: [H,W] bool, the surface moved.
        mirror: [H,W] bool, the surface reflects: its picture may change although it stands still.
    """

    depth: Float32
    motion: Float32
    moving: Bool
    mirror: Bool


@dataclass(frozen=True, slots=True, eq=False)
class _EmptyRoom:
    """The room without movers, seen by one camera: colour [H*W,3], number of parts, bounds of M spans of pixels."""

    colour: Float32
    parts: int
    centre: Float64
    reach: Float64
    axis: Float64
    angle: Float64
    far: Float64
    air: Float64
    air_reach: Float64
    mirrored: Bool


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """Hits of N rays: distance [N], part [N], local point and normal [N,3], world point and normal [N,3]."""

    distance: Float64
    part: Int32
    point: Float64
    normal: Float64
    world_point: Float64
    world_normal: Float64


@lru_cache(maxsize=8)
def scene_at(spec: SyntheticSpec, index: int) -> SceneArrays:
    """All parts at frame `index`; the order of parts is the same at every frame."""
    generator = np.random.default_rng(spec.seed)
    phase = float(generator.uniform()) if spec.seed else 0.0
    return assemble(spec.place.still(generator) + spec.place.moving(spec.time_of(index), spec.cycle, phase))


def ground_truth(spec: SyntheticSpec, index: int, camera_index: int) -> GroundTruth:
    """The truth of `render_image` at frame `index`; the same for the same arguments.

    Raises:
        ValueError: `index` or `camera_index` lies outside the clip.
    """
    _check(spec, index)
    if not 0 <= camera_index < spec.cameras:
        raise ValueError(f"camera {camera_index} is outside the rig of {spec.cameras}")
    camera = cameras(spec)[camera_index]
    scene, before = scene_at(spec, index), scene_at(spec, max(index - 1, 0))
    truth = _in_batches(np.arange(spec.width * spec.height), lambda pixels: _truth(scene, before, camera, pixels))
    depth = np.where(truth[:, 0] < _SKY, truth[:, 0], np.float32(np.inf))
    motion, mirror = truth[:, 1:4], truth[:, 4] > 0
    shape = (spec.height, spec.width)
    return GroundTruth(
        depth=depth.reshape(shape),
        motion=motion.reshape(*shape, 3),
        moving=(np.linalg.norm(motion, axis=1) > _MOVED).reshape(shape),
        mirror=mirror.reshape(shape),
    )


def render_image(spec: SyntheticSpec, index: int, camera_index: int) -> UInt8:
    """The picture of one camera at frame `index`, [H,W,3] uint8; ValueError as in `ground_truth`.

    Most of a picture stands still: only spans of pixels that a mover can cover, shade or be mirrored in are rendered
    again, the others come from a picture of the empty room, which is kept for each camera.
    """
    _check(spec, index)
    if not 0 <= camera_index < spec.cameras:
        raise ValueError(f"camera {camera_index} is outside the rig of {spec.cameras}")
    camera, scene = cameras(spec)[camera_index], scene_at(spec, index)
    room = _empty_room(spec, camera_index)
    dirty = np.empty(len(room.reach), np.bool_)
    bounds = (camera.centre, room.centre, room.reach, room.axis, room.angle, room.far, room.air, room.air_reach)
    touched(*bounds, scene.solid, room.parts, spec.place.lamps, dirty)
    pixels = np.flatnonzero(np.repeat(dirty | room.mirrored, _SPAN)[: spec.width * spec.height])
    colour = room.colour.astype(np.float64)
    colour[pixels] = _in_batches(pixels, lambda some: _colour(spec.place, scene, camera, some))
    return develop(colour.reshape(spec.height, spec.width, 3), spec, index, camera_index)


def render_view(spec: SyntheticSpec, index: int, camera: Camera) -> UInt8:
    """[H,W,3] uint8 what `camera`, of the rig or not, would film at frame `index` at the exposure of the first camera.

    Raises:
        ValueError: `index` lies outside the clip.
    """
    _check(spec, index)
    scene, pixels = scene_at(spec, index), np.arange(camera.width * camera.height)
    colour = _in_batches(pixels, lambda some: _colour(spec.place, scene, camera, some))
    return develop(colour.reshape(camera.height, camera.width, 3), spec, index, 0)


def develop(radiance: Float64, spec: SyntheticSpec, index: int, camera_index: int) -> UInt8:
    """The picture that a camera takes of linear light [H,W,3]: exposure, film curve, gamma 2, noise, 8 bits."""
    exposed = radiance * (spec.place.brightness * exposures(spec, index)[camera_index])
    levels = 255.0 * np.sqrt(1.0 - np.exp(-exposed))
    if spec.noise > 0:
        generator = np.random.default_rng([spec.seed, camera_index, index])
        levels += spec.noise * generator.standard_normal(levels.shape, dtype=np.float32)
    return np.asarray(np.clip(np.round(levels), 0, 255), np.uint8)


def surface_motion(spec: SyntheticSpec, index: int, camera: Camera) -> Float32:
    """[H,W] how far, in pixels of `camera`, the surface that it sees at frame `index` - 1 moves until frame `index`.

    Seen at the pixels' centres; 0 where nothing moves, and in the step to frame 0. A mirror's surface does not move,
    whatever it shows. Any camera will do, of the rig or not, without lens distortion.
    """
    _check(spec, index)
    before, now = scene_at(spec, max(index - 1, 0)), scene_at(spec, index)
    truth = _in_batches(
        np.arange(camera.width * camera.height), lambda pixels: _truth(before, now, camera, pixels)
    ).astype(np.float64)
    row, column = np.divmod(np.arange(camera.width * camera.height), camera.width)
    centres = np.stack([column + 0.5, row + 0.5], axis=1)
    rays = np.concatenate([centres, np.ones((len(centres), 1))], axis=1) @ np.linalg.inv(camera.intrinsics).T
    # `_truth` tells how far the surface came from the other instant; here that is the later one, so the sign turns
    there = rays * truth[:, :1] - truth[:, 1:4] @ camera.world_to_camera[:3, :3].T
    projected = there @ camera.intrinsics.T
    moved = np.linalg.norm(projected[:, :2] / np.maximum(projected[:, 2:], 1e-6) - centres, axis=1)
    moved[np.linalg.norm(truth[:, 1:4], axis=1) <= _MOVED] = 0.0
    return np.asarray(moved.reshape(camera.height, camera.width), np.float32)


def moving_surface(spec: SyntheticSpec, index: int, camera: Camera) -> Bool:
    """[H,W] bool, whether what `camera` sees at frame `index` moves in the step to that frame.

    In frame 0, to which nothing moves, the step to frame 1 counts instead. Any camera will do, of the rig or not,
    without lens distortion.
    """
    _check(spec, index)
    other = index - 1 if index else min(1, spec.frames - 1)
    now, then = scene_at(spec, index), scene_at(spec, other)
    truth = _in_batches(np.arange(camera.width * camera.height), lambda pixels: _truth(now, then, camera, pixels))
    return np.asarray(np.linalg.norm(truth[:, 1:4], axis=1) > _MOVED, np.bool_).reshape(camera.height, camera.width)


def depth_bounds(spec: SyntheticSpec) -> tuple[float, float]:
    """Nearest and farthest depth that any camera sees at frame 0, the sky left out, with a margin, in metres."""
    depths = []
    scene = scene_at(spec, 0)
    for camera in cameras(spec):
        small = camera.scaled(64, 36)
        depths.append(_truth(scene, scene, small, np.arange(64 * 36))[:, 0])
    solid = np.concatenate(depths)
    solid = solid[solid < _SKY]
    return 0.8 * float(solid.min()), 1.1 * float(solid.max())


def _check(spec: SyntheticSpec, index: int) -> None:
    if not 0 <= index < spec.frames:
        raise ValueError(f"frame {index} is outside the clip of {spec.frames}")


def _changed(now: SceneArrays, before: SceneArrays) -> Bool:
    """[P] which parts have another pose."""
    turned = (now.solid.rotation != before.solid.rotation).any(axis=(1, 2))
    return np.asarray(turned | (now.solid.translation != before.solid.translation).any(axis=1), np.bool_)


def _carry(points: Float64, part: int, now: SceneArrays, before: SceneArrays) -> Float64:
    """[N,3] how far world `points` that ride on `part` moved from `before` to `now`."""
    local = (points - now.solid.translation[part]) @ now.solid.rotation[part]
    return np.asarray(points - (local @ before.solid.rotation[part].T + before.solid.translation[part]), np.float64)


@lru_cache(maxsize=64)
def _empty_room(spec: SyntheticSpec, camera_index: int) -> _EmptyRoom:
    camera, parts = cameras(spec)[camera_index], spec.place.still(np.random.default_rng(spec.seed))
    scene, pixels = assemble(parts), np.arange(spec.width * spec.height)
    colour = _in_batches(pixels, lambda some: _colour(spec.place, scene, camera, some)).astype(np.float32)
    origins, directions = _rays(camera, pixels, _CENTRE)
    hits = _hits(scene, origins, directions)
    spans = -(-len(pixels) // _SPAN)
    centre, axis, air = np.empty((3, spans, 3))
    reach, angle, air_reach = np.empty((3, spans))
    balls_round(hits.world_point, _SPAN, centre, reach)
    balls_round(hits.world_point + AIR * hits.world_normal, _SPAN, air, air_reach)
    cones_round(directions, _SPAN, axis, angle)
    far = np.maximum.reduceat(hits.distance, np.arange(0, len(pixels), _SPAN)) + 0.1
    pixel = 1.0 / float(camera.intrinsics[0, 0])  # the samples lie up to a pixel outside the centres' bounds
    slack = 2 * pixel * far
    mirrored = np.logical_or.reduceat(scene.mirror[hits.part] > 0, np.arange(0, len(pixels), _SPAN))
    return _EmptyRoom(
        colour, len(parts), centre, reach + slack, axis, angle + pixel, far, air, air_reach + slack, mirrored
    )


def _in_batches(pixels: Int64, work: Callable[[Int64], NDArray[_T]]) -> NDArray[_T]:
    """The rows that `work` makes of `pixels`, made by a thread for each batch."""
    batches = [pixels[start : start + _BATCH] for start in range(0, max(len(pixels), 1), _BATCH)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.concatenate(list(pool.map(work, batches)))


def _rays(camera: Camera, pixels: Int64, offsets: Float64) -> tuple[Float64, Float64]:
    """Origins and unit directions [N * S, 3], the S samples of a pixel side by side; `pixels` [N] counts row by row."""
    row, column = np.divmod(pixels, camera.width)
    x, y = column[:, None] + offsets[:, 0], row[:, None] + offsets[:, 1]
    places = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    directions = places @ (np.linalg.inv(camera.intrinsics).T @ camera.world_to_camera[:3, :3])
    directions /= np.sqrt(np.einsum("ni,ni->n", directions, directions))[:, None]
    return np.broadcast_to(camera.centre, directions.shape), directions


def _hits(scene: SceneArrays, origins: Float64, directions: Float64) -> _Hits:
    count = len(origins)
    distance, part = np.empty(count), np.empty(count, np.int32)
    point, normal = np.empty((count, 3)), np.empty((count, 3))
    origins = np.ascontiguousarray(origins)
    cast(origins, directions, scene.solid, distance, part, point, normal)
    world_normal = np.einsum("nij,nj->ni", scene.solid.rotation[part], normal)
    return _Hits(distance, part, point, normal, origins + distance[:, None] * directions, world_normal)


def _radiance(
    place: Kind, scene: SceneArrays, hits: _Hits, directions: Float64, footprint: Float64, group: int
) -> Float64:
    """[N,3] light from surfaces without their mirror reflections."""
    albedo, radiance = np.empty((len(directions), 4)), np.empty((len(directions), 3))
    paint(
        hits.part, hits.point, hits.normal, footprint, scene.solid.size, scene.material, scene.tint, scene.seed, albedo
    )
    light(
        hits.world_point,
        hits.world_normal,
        hits.part,
        -directions,
        albedo,
        scene.solid,
        place.lamps,
        place.ambient,
        group,
        radiance,
    )
    return radiance


def _colour(place: Kind, scene: SceneArrays, camera: Camera, pixels: Int64) -> Float64:
    """[N,3] linear light of `pixels` [N], four samples a pixel and one mirror reflection."""
    origins, directions = _rays(camera, pixels, _SAMPLES)
    hits = _hits(scene, origins, directions)
    angle = 0.5 / float(camera.intrinsics[0, 0])
    radiance = _radiance(place, scene, hits, directions, angle * hits.distance, len(_SAMPLES))
    shiny = np.flatnonzero(scene.mirror[hits.part] > 0)
    if len(shiny):
        normal, incoming = hits.world_normal[shiny], directions[shiny]
        facing = np.einsum("ni,ni->n", incoming, normal)[:, None]
        bounced = incoming - 2.0 * facing * normal
        bounced /= np.linalg.norm(bounced, axis=1, keepdims=True)
        seen = _hits(scene, hits.world_point[shiny] + 1e-4 * normal, bounced)
        path = hits.distance[shiny] + seen.distance
        share = scene.mirror[hits.part[shiny], None]
        share = share + (1.0 - share) * np.clip(1.0 + facing, 0.0, 1.0) ** 5  # Schlick's Fresnel term
        reflected = _radiance(place, scene, seen, bounced, 2.0 * angle * path, 1)
        radiance[shiny] += share * (reflected - radiance[shiny] * (scene.mirror[hits.part[shiny], None] > 0.5))
    return np.asarray(radiance.reshape(len(pixels), len(_SAMPLES), 3).mean(axis=1), np.float64)


def _truth(scene: SceneArrays, before: SceneArrays, camera: Camera, pixels: Int64) -> Float32:
    """[N,5] depth, motion and mirror of `pixels` [N], at their centres."""
    origins, directions = _rays(camera, pixels, _CENTRE)
    hits = _hits(scene, origins, directions)
    rows = np.zeros((len(pixels), 5), np.float32)
    rows[:, 0] = hits.distance * (directions @ camera.world_to_camera[2, :3])
    for part in np.flatnonzero(_changed(scene, before)).tolist():
        on = np.flatnonzero(hits.part == part)
        rows[on, 1:4] = _carry(hits.world_point[on], part, scene, before)
    rows[:, 4] = scene.mirror[hits.part]
    return rows
