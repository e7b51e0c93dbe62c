"""Between the trainer's tensors and the integer state that travels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float32, Int16, Int32, Int64
from streamlod.core.camera import Camera
from streamlod.core.scene.anchors import (
    FEATURE_LATENTS,
    LATENTS,
    OFFSET_LATENTS,
    AnchorLevel,
    AnchorWeights,
    Scene,
    SceneHeader,
    new_identifier,
)
from streamlod.core.scene.expand import EXTRA_LEVEL_UNIT, anchor_positions, dequantise
from streamlod.core.scene.octree import morton_key
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import Precision, usual_precision


def scene_of(
    field: Field,
    predict: PredictConfig,
    cameras: tuple[Camera, ...],
    fps: float,
    version: int,
    precision: Precision | None = None,
    motion_cell: float | None = None,
) -> Scene:
    """A keyframe: the field rounded as it will be sent, to `precision` or the usual one.

    Args:
        motion_cell: width of the cells that motion is measured in, in world units; by default the octree's.
    """
    precision = precision or usual_precision(field, 0)
    cell = field.octree.motion_cell if motion_cell is None else motion_cell
    field = precision.sent(field)
    slots = field.slots
    header = SceneHeader(
        octree=field.octree,
        gaussians_per_anchor=slots,
        view_dependent=field.view_dependent,
        reference_distance=field.reference_distance,
        position_steps=np.full(field.octree.levels, cell / predict.position_steps_per_cell, np.float32),
        feature_steps=_array(precision.feature),
        offset_steps=_array(precision.offset.flatten()),
        scaling_steps=_array(precision.scaling),
        background=np.zeros(3, np.float32),
        fps=fps,
        cameras=cameras,
    )
    network = field.network
    weights = AnchorWeights(
        hidden_weight=_sendable(network.hidden_weight),
        hidden_bias=_sendable(network.hidden_bias),
        output_weight=_sendable(network.output_weight),
        output_bias=_sendable(network.output_bias),
        feature_decoder=_feature_decoder(field.feature, predict.feature_step * _mean_length(precision.basis)),
        offset_decoder=_offset_decoder(3 * slots, predict.offset_step),
    )
    here = _in_order(field.to("cpu"))
    level = here.level.numpy()
    moved = here.position.numpy() - here.octree.node_of(here.voxel.numpy(), level)
    position = np.round(moved / header.position_steps[level, None]).astype(np.int32)
    return Scene(
        header,
        weights,
        levels_of(here, position, header),
        keyframe=version,
        version=version,
        identifier=new_identifier(),
    )


def motion_cell_of(scene: Scene, predict: PredictConfig) -> float:
    """Width of the cells that motion is measured in, in world units, of a scene by `scene_of`."""
    return float(scene.header.position_steps[0]) * predict.position_steps_per_cell


def field_of(scene: Scene) -> Field:
    """All rows of `scene`, dead ones too, levels one after another, dequantised by the decoder's own arithmetic."""
    header, weights = scene.header, scene.weights
    parts = [dequantise(header, weights, level, np.arange(len(level))) for level in scene.levels]
    feature, offset, scaling = (np.concatenate([part[i] for part in parts]) for i in range(3))
    position = np.concatenate([anchor_positions(header, n, level) for n, level in enumerate(scene.levels)])
    extra = np.concatenate([level.extra_level for level in scene.levels]) * EXTRA_LEVEL_UNIT
    network = (weights.hidden_weight, weights.hidden_bias, weights.output_weight, weights.output_bias)
    return Field(
        octree=header.octree,
        reference_distance=header.reference_distance,
        view_dependent=header.view_dependent,
        level=torch.from_numpy(np.repeat(np.arange(len(scene.levels)), [len(level) for level in scene.levels])),
        voxel=torch.from_numpy(np.concatenate([level.voxel for level in scene.levels])),
        extra_level=torch.from_numpy(extra.astype(np.float32)),
        position=torch.from_numpy(position),
        feature=torch.from_numpy(feature.astype(np.float32)),
        offset=torch.from_numpy(offset.astype(np.float32)),
        scaling=torch.from_numpy(scaling.astype(np.float32)),
        network=Network(*(torch.from_numpy(array) for array in network)),
    )


def level_starts(scene: Scene) -> Int64:
    """[L+1] where each level's rows begin in the order of `field_of`."""
    return np.concatenate([[0], np.cumsum([len(level) for level in scene.levels])]).astype(np.int64)


def levels_of(field: Field, position: Int32, header: SceneHeader) -> tuple[AnchorLevel, ...]:
    """Anchors of `field` on the CPU, `position` [N,3] steps from their nodes, by level, as they are sent."""
    levels = []
    for number in range(field.octree.levels):
        rows = torch.nonzero(field.level == number)[:, 0]
        here, count = field.with_rows(rows), len(rows)
        levels.append(
            AnchorLevel(
                voxel=here.voxel.numpy(),
                position=position[rows.numpy()],
                feature=_integers(here.feature, header.feature_steps),
                offset=_integers(here.offset.flatten(1), header.offset_steps),
                scaling=_integers(here.scaling, header.scaling_steps),
                extra_level=_integers(here.extra_level.clamp(min=0), np.float32(EXTRA_LEVEL_UNIT)),
                latent=np.zeros((count, LATENTS), np.int16),
                alive=np.ones(count, np.bool_),
            )
        )
    return tuple(levels)


def _in_order(field: Field) -> Field:
    """The anchors of each level in Morton order, one level after another."""
    level, voxel = field.level.numpy(), field.voxel.numpy()
    of_levels = [np.flatnonzero(level == number) for number in range(field.octree.levels)]
    rows = [rows[np.argsort(morton_key(voxel[rows]), kind="stable")] for rows in of_levels]
    return field.with_rows(torch.from_numpy(np.concatenate(rows)))


def _integers(values: Tensor, steps: Float32 | np.float32) -> Int16:
    rounded = np.round(values.detach().numpy() / steps)
    return np.nan_to_num(rounded).clip(-32768, 32767).astype(np.int16)


def _feature_decoder(feature: Tensor, step: float) -> Float32:
    """[12,F] latents that each change one channel by `step`: the channels in which features [N,F] differ most.

    In the basis in which they are sent (`core.train.keyframe.precision`) features are uncorrelated, and a step of any
    channel changes the pictures by the same amount. Random directions took more latents for less (docs/history/log.md).
    """
    spread = (feature - feature.mean(dim=0)).double().square().sum(dim=0)
    chosen = torch.argsort(spread.cpu(), descending=True, stable=True)[:FEATURE_LATENTS]
    decoder = torch.zeros(FEATURE_LATENTS, feature.shape[1])
    decoder[torch.arange(len(chosen)), chosen] = step
    return _sendable(decoder)


def _offset_decoder(numbers: int, step: float) -> Float32:
    """[12,M] latents that each change one of M offset numbers by `step`; random orthogonal directions if M > 12."""
    if numbers <= OFFSET_LATENTS:
        return _sendable(step * torch.eye(OFFSET_LATENTS, numbers))
    orthogonal, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((numbers, numbers)))
    return _sendable(step * torch.from_numpy(orthogonal[:OFFSET_LATENTS]))


def _mean_length(basis: Tensor) -> float:
    """Root mean square, over all directions, of the length of a unit vector [F] times `basis` [F,F]."""
    return float(basis.double().square().sum().div(len(basis)).sqrt())


def _array(steps: Tensor) -> Float32:
    return np.ascontiguousarray(steps.detach().float().cpu().numpy())


def _sendable(value: Tensor) -> Float32:
    """float32 values that are exact in float16, as weights travel."""
    return np.ascontiguousarray(value.detach().half().float().cpu().numpy())
