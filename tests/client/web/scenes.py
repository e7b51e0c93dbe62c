"""A scene to look at: two knots of coloured anchors over a floor, one of them turning. No randomness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.scene.anchors import LATENTS, SCALINGS, AnchorLevel, AnchorWeights, Scene, SceneHeader
from streamlod.core.scene.octree import Octree, morton_key

SLOTS, FEATURES, LEVELS = 4, 12, 3
_LIFT = 8.0  # keeps the hidden layer in the linear half of its rectifier
_FEATURE_STEP, _OFFSET_STEP, _SCALING_STEP = 0.05, 0.02, 0.0625


def make_scene(anchors: int = 600, view_dependent: bool = True) -> Scene:
    """A fresh keyframe with about `anchors` anchors on three levels."""
    header = make_header(view_dependent)
    shares = (0.15, 0.3, 0.55)
    size = 0.09 * min(1.0, (600 / anchors) ** 0.5)
    levels = tuple(_level(header, number, round(anchors * share), size) for number, share in enumerate(shares))
    return Scene(header, make_weights(view_dependent), levels, 0, 0)


def make_header(view_dependent: bool) -> SceneHeader:
    """A rig of five cameras on an arc in front of the scene."""
    target, up = np.array([0.0, -0.35, 0.0]), np.array([0.0, -1.0, 0.0])
    cameras = tuple(_camera(i, angle, target, up) for i, angle in enumerate(np.linspace(-0.7, 0.7, 5)))
    return SceneHeader(
        octree=Octree(np.zeros(3), 0.16, LEVELS),
        gaussians_per_anchor=SLOTS,
        view_dependent=view_dependent,
        reference_distance=4.0,
        position_steps=(0.02 / 2.0 ** np.arange(LEVELS)).astype(np.float32),
        feature_steps=np.full(FEATURES, _FEATURE_STEP, np.float32),
        offset_steps=np.full(3 * SLOTS, _OFFSET_STEP, np.float32),
        scaling_steps=np.full(SCALINGS, _SCALING_STEP, np.float32),
        background=np.array([0.08, 0.09, 0.12], np.float32),
        fps=30.0,
        cameras=cameras,
    )


def _camera(number: int, angle: float, target: Float64, up: Float64) -> Camera:
    eye = np.array([3.2 * np.sin(angle), -0.9, -3.2 * np.cos(angle)])
    return pinhole(f"cam{number:02d}", (310.0, 300.0), (163.0, 118.0), (320, 240), look_at(eye, target, up))


def make_weights(view_dependent: bool) -> AnchorWeights:
    """Features 0-2 become colour, 3-5 size, 6-9 rotation, 10 opacity; the view adds a sheen."""
    inputs = FEATURES + (4 if view_dependent else 0)
    hidden, output = np.zeros((inputs, 32)), np.zeros((32, 11 * SLOTS))
    bias, output_bias = np.full(32, _LIFT), np.zeros(11 * SLOTS)
    for feature in range(FEATURES):
        hidden[feature, feature] = 1
    if view_dependent:
        hidden[FEATURES : FEATURES + 3, 12:15] = np.eye(3)
    for slot in range(SLOTS):
        columns = [SLOTS + 3 * slot + c for c in range(3)] + [4 * SLOTS + 3 * slot + c for c in range(3)]
        columns += [7 * SLOTS + 4 * slot + c for c in range(4)] + [slot]
        for source, column in enumerate(columns):
            output[source, column] = 1
        output[12 + slot % 3, SLOTS + 3 * slot : SLOTS + 3 * slot + 3] = 0.4 if view_dependent else 0
    output_bias -= _LIFT * output.sum(axis=0)
    decoder = np.zeros((12, FEATURES))
    decoder[:, :12] = 0.05 * np.eye(12)
    offsets = np.zeros((12, 3 * SLOTS))
    offsets[:12, :12] = 0.01 * np.eye(12)
    return AnchorWeights(*(_half(x) for x in (hidden, bias, output, output_bias, decoder, offsets)))


def _half(values: Float64) -> Float32:
    return values.astype(np.float16).astype(np.float32)


def _level(header: SceneHeader, number: int, count: int, size: float) -> AnchorLevel:
    points, colours = _surface(count)
    voxel = header.octree.voxel_of(points, number)
    order = np.argsort(morton_key(voxel), kind="stable")
    voxel, points, colours = voxel[order], points[order], colours[order]
    _, first = np.unique(voxel, axis=0, return_index=True)
    keep = np.sort(first)
    voxel, points, colours = voxel[keep], points[keep], colours[keep]
    rest = points - header.octree.node_of(voxel, number)
    feature = np.zeros((len(voxel), FEATURES))
    feature[:, :3] = np.log(colours / (1 - colours))
    feature[:, 6:10] = 0.4 * np.sin(7 * points @ np.array([[1, 2, 3, 4], [4, 3, 2, 1], [2, 4, 1, 3]]))
    feature[:, 10] = 1.2 + 0.4 * np.sin(9 * points[:, 0])
    index = np.arange(len(voxel))[:, None]
    spread = np.sin(index * np.arange(1, 3 * SLOTS + 1) * 1.7)
    return AnchorLevel(
        voxel=voxel,
        position=np.round(rest / float(header.position_steps[number])).astype(np.int32),
        feature=np.round(feature / _FEATURE_STEP).astype(np.int16),
        offset=np.round(0.5 * spread / _OFFSET_STEP).astype(np.int16),
        scaling=np.full((len(voxel), SCALINGS), round((np.log(size) - 0.35 * number) / _SCALING_STEP), np.int16),
        extra_level=np.zeros(len(voxel), np.int16),
        latent=np.zeros((len(voxel), LATENTS), np.int16),
        alive=np.ones(len(voxel), np.bool_),
    )


def _surface(count: int) -> tuple[Float64, Float64]:
    """`count` points and their colours: a third floor, two thirds knots."""
    floor = count // 3
    side = np.arange(floor) * 0.6180339887 % 1 * 2 - 1
    depth = np.arange(floor) / max(floor, 1) * 2 - 1
    tile = ((np.floor(side * 3) + np.floor(depth * 3)) % 2)[:, None]
    ground = np.stack([1.5 * side, np.zeros(floor), 1.5 * depth], axis=1)
    ground_colour = 0.25 + 0.4 * tile * np.array([0.9, 0.95, 1.0])
    number = np.arange(count - floor)
    left = number % 2 == 0
    along = number / max(count - floor, 1) * 2 * np.pi * 2
    around = number * 2.399963
    radius = 0.32 + 0.12 * np.cos(1.5 * along)
    x, z = radius * np.cos(along), radius * np.sin(along)
    tube = 0.09 * np.stack([np.cos(around), np.sin(around), np.cos(around + 1)], axis=1)
    knot = np.stack([x, -0.55 + 0.22 * np.sin(1.5 * along), z], axis=1) + tube
    knot[:, 0] += np.where(left, -0.62, 0.62)
    warm, cold = np.array([0.95, 0.45, 0.2]), np.array([0.2, 0.55, 0.9])
    shade = 0.7 + 0.3 * np.sin(around)[:, None]
    colour = np.where(left[:, None], warm, cold) * shade
    return np.concatenate([ground, knot]), np.clip(np.concatenate([ground_colour, colour]), 0.03, 0.97)


def moved(scene: Scene, version: int | None = None) -> Scene:
    """The next state: the left knot turns, and its colour breathes."""
    next_version = scene.version + 1 if version is None else version
    angle = 0.12
    levels = []
    for number, level in enumerate(scene.levels):
        points = scene.header.octree.node_of(level.voxel, number)
        points = points + level.position * float(scene.header.position_steps[number])
        inside = (points[:, 0] < -0.05) & (points[:, 1] < -0.12)
        centre = np.array([-0.62, 0.0, 0.0])
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        delta = (points - centre) @ turn.T + centre - points
        position = level.position + np.round(delta / float(scene.header.position_steps[number])).astype(np.int32)
        latent = level.latent.copy()
        latent[inside, :3] += round(4 * np.sin(next_version / 5))
        levels.append(replace(level, position=np.where(inside[:, None], position, level.position), latent=latent))
    return replace(scene, levels=tuple(levels), version=next_version)
