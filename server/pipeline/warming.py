"""Calls of every kernel, so that it is compiled before it is needed: what `streamlod warm` goes through.

Each part with kernels has a function here that calls all of them once; Numba keeps the results on disk. The imports of
what trains are inside the functions, as a server needs the codec alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.arrays import Float32
from streamlod.core.errors import StreamlodError
from streamlod.core.scene.anchors import (
    FEATURE_LATENTS,
    HIDDEN,
    OFFSET_LATENTS,
    OUTPUTS,
    SCALINGS,
    AnchorWeights,
    Scene,
    SceneHeader,
    empty_level,
)
from streamlod.core.scene.octree import Octree
from streamlod.core.scene.residual import difference


def warm_codec() -> None:
    """Encode and decode a scene of eight anchors: about 12 seconds once."""
    before = _scene()
    level = before.levels[0]
    moved = replace(level, position=level.position + np.int32(1), latent=level.latent + np.int16(1))
    after = replace(before, levels=(moved,), version=1)
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(before, time_ns=0))
    decoder.push(encode_residual(before, difference(before, after), time_ns=0))


def warm_rasteriser() -> None:
    """Draw one Gaussian in all ways, forward and backward: about half a minute once."""
    from streamlod.core.camera import pinhole
    from streamlod.core.render.cpu.backdrop import canvas_of, forward_over, prepare
    from streamlod.core.render.cpu.dirty_tiles import near_depths, reached_tiles
    from streamlod.core.render.cpu.frame import backward, forward
    from streamlod.core.render.cpu.layers import layered
    from streamlod.core.render.cpu.photometric import photometric_sums
    from streamlod.core.render.cpu.workspace import Workspace
    from streamlod.core.render.tiles import Box
    from streamlod.core.scene.gaussians import GaussianCloud

    def row(*values: float) -> Float32:
        return np.array([values], np.float32)

    workspace, background = Workspace(), np.zeros(3, np.float32)
    camera = pinhole("warm", (8.0, 8.0), (4.0, 4.0), (32, 8), np.eye(4))
    cloud = GaussianCloud(row(0, 0, 1), row(1, 0, 0, 0), row(0.1, 0.1, 0.1), np.ones(1, np.float32), row(1, 1, 1))
    frame = forward(workspace, cloud, camera, background)
    backward(workspace, frame, cloud, np.ones_like(frame.image))
    photometric_sums(frame.image, frame.image, 0.2, (Box(0, 0, 8, 8),))
    near = near_depths(camera, cloud, 1.0)  # one tile of two
    reached_tiles(camera, cloud, near.tiles)
    backdrop = layered(prepare(cloud, camera, near.tiles, frame.image), near)
    forward_over(workspace, cloud, backdrop, background, canvas_of(backdrop))


def warm_trainer() -> None:
    """Take one step of everything: some seconds once."""
    from streamlod.core.scene.entropy_model import BINS
    from streamlod.core.train.kernels.adam import adam_step
    from streamlod.core.train.kernels.decode import activate, differentiate
    from streamlod.core.train.kernels.rate import residual_bits
    from streamlod.core.train.kernels.windows import best_depths

    def zeros(*shape: int) -> Float32:
        return np.zeros(shape, np.float32)

    numbers = tuple(np.float32(number) for number in (0.1, 1.0, 0.1, 0.001, 1e-15))
    adam_step(1, zeros(1), zeros(1), zeros(1), zeros(1), numbers, np.zeros(1, np.int64))
    sums = np.zeros((1, 3))
    residual_bits(sums, zeros(1, 2), zeros(1, 1), zeros(BINS, 3), 0.5, np.float32(4), zeros(1, 2), zeros(1, 1))
    parts = [zeros(1, width) for width in (3, 4, 3, 1, 3)]
    activate(1, zeros(1, 11), zeros(1, 3), zeros(1, 6), zeros(1, 3), zeros(1, 6), *parts)
    known = (zeros(1, 3), zeros(1, 6), zeros(1, 6), *parts[2:])
    differentiate(1, *known, *parts, zeros(1, 11), zeros(1, 3), zeros(1, 6), zeros(1, 3))
    pixel, ends = np.zeros(1, np.int64), np.linspace(0.5, 1.0, 2)
    poses = (np.eye(3)[None], np.zeros((1, 3)))
    best_depths(1, zeros(1, 1, 3), zeros(1, 1, 1, 3), *poses, ends, pixel, pixel, pixel.copy(), zeros(1))


def warm_first_points() -> None:
    """Draw a tiny synthetic clip, and sweep planes through it."""
    from streamlod.core.initialise import first_points
    from streamlod.core.synthetic import SyntheticSpec, open_synthetic

    spec = SyntheticSpec(cameras=3, frames=2, width=64, height=36)
    clip = open_synthetic(spec)
    frame = list(clip.frames())[-1]
    with suppress(StreamlodError):  # pictures this small show too little to find many points
        first_points(frame, clip.cameras, depth_bounds=clip.depth_bounds, method="sweep")


WARM_UPS: Mapping[str, Callable[[], None]] = {  # what takes longest comes first
    "synthetic clip and first points": warm_first_points,
    "codec": warm_codec,
    "rasteriser": warm_rasteriser,
    "trainer": warm_trainer,
}


def warm_all() -> Iterator[str]:
    """Go through all parts, each in a process of its own, one for each core; gives the name of each that is ready."""
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn"), max_tasks_per_child=1) as pool:
        parts = {pool.submit(warm_up): name for name, warm_up in WARM_UPS.items()}
        for part in as_completed(parts):
            part.result()
            yield parts[part]


def _scene() -> Scene:
    def one(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return np.ones(count, np.float32)

    octree = Octree(np.zeros(3), 1.0, 1)
    header = SceneHeader(octree, 1, False, 1.0, one(1), one(1), one(3), one(SCALINGS), one(3), 1.0, ())
    shapes = ((1, HIDDEN), (HIDDEN,), (HIDDEN, OUTPUTS), (OUTPUTS,), (FEATURE_LATENTS, 1), (OFFSET_LATENTS, 3))
    weights = AnchorWeights(*(np.zeros(shape, np.float32) for shape in shapes))
    corners = np.indices((2, 2, 2), np.int32).reshape(3, 8).T.copy()
    empty = empty_level(1, 1)
    columns = {n: np.zeros((8, *getattr(empty, n).shape[1:]), getattr(empty, n).dtype) for n in empty.__slots__}
    level = replace(empty, **{**columns, "voxel": corners, "alive": np.ones(8, np.bool_)})
    return Scene(header, weights, (level,), 0, 0)
