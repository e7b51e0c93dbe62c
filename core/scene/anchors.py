"""The integer state that is transmitted, and the small network that turns it into Gaussians.

Everything that changes from frame to frame is an integer, so that encoder, Python client and browser hold the same
state to the bit; floats appear only in `core.scene.expand`, after decoding.
"""

from __future__ import annotations

import secrets
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float32, Int16, Int32, check_array
from streamlod.core.camera import Camera
from streamlod.core.scene.metadata import NOTHING_KNOWN, Metadata
from streamlod.core.scene.octree import Octree

FEATURE_LATENTS = 12  # paper section V-A: latent size 12 for features and for offsets
OFFSET_LATENTS = 12
LATENTS = FEATURE_LATENTS + OFFSET_LATENTS
HIDDEN = 32
OUTPUTS = 11  # per Gaussian: opacity 1, colour 3, scale 3, rotation 4
VIEW_INPUTS = 4  # unit direction 3, relative distance 1
SCALINGS = 6  # log-scales: 3 of the offsets, 3 of the Gaussians


@dataclass(frozen=True, slots=True, eq=False)
class AnchorLevel:
    """N anchors of one octree level.

    Order: Morton at a keyframe, then anchors in the order in which they were added; never reordered or compacted
    before the next keyframe. A removed anchor keeps its row, with `alive` False.

    Attributes:
        voxel: [N,3] int32 grid node.
        position: [N,3] int32 offset from the node, in the level's position steps.
        feature: [N,F] int16 base feature, in `SceneHeader.feature_steps`.
        offset: [N,3K] int16 base offsets of the K Gaussians (x y z of the first, of the second, ...), in offset steps.
        scaling: [N,6] int16 log-scales, in scaling steps.
        extra_level: [N] int16 the paper's extra level, in 1/64 of a level.
        latent: [N,24] int16, 12 of the feature and 12 of the offsets, accumulated since the keyframe.
        alive: [N] bool.
    """

    voxel: Int32
    position: Int32
    feature: Int16
    offset: Int16
    scaling: Int16
    extra_level: Int16
    latent: Int16
    alive: Bool

    def __post_init__(self) -> None:
        count = len(self.voxel)
        check_array("voxel", self.voxel, (None, 3), np.int32)
        check_array("position", self.position, (count, 3), np.int32)
        check_array("feature", self.feature, (count, None), np.int16)
        check_array("offset", self.offset, (count, None), np.int16)
        check_array("scaling", self.scaling, (count, SCALINGS), np.int16)
        check_array("extra_level", self.extra_level, (count,), np.int16)
        check_array("latent", self.latent, (count, LATENTS), np.int16)
        check_array("alive", self.alive, (count,), np.bool_)

    def __len__(self) -> int:
        return len(self.voxel)

    @property
    def slots(self) -> int:
        """Gaussians of an anchor."""
        return int(self.offset.shape[1]) // 3

    @property
    def row_bytes(self) -> int:
        """Memory of a row."""
        return 87 + 2 * int(self.feature.shape[1] + self.offset.shape[1])

    def state(self) -> Iterator[bytes]:
        """Everything that the level holds, little-endian, what never changes in a row first (FORMAT.md section 11)."""
        fixed = (self.voxel, self.feature, self.offset, self.scaling, self.extra_level)
        for values in (*fixed, self.position, self.latent, self.alive):
            yield values.astype(values.dtype.newbyteorder("<")).tobytes()

    def digest(self) -> int:
        """CRC-32 of the state, to compare decoders with."""
        crc = 0
        for column in self.state():
            crc = zlib.crc32(column, crc)
        return crc


def empty_level(features: int, gaussians_per_anchor: int) -> AnchorLevel:
    """A level without anchors."""
    return AnchorLevel(
        voxel=np.zeros((0, 3), np.int32),
        position=np.zeros((0, 3), np.int32),
        feature=np.zeros((0, features), np.int16),
        offset=np.zeros((0, 3 * gaussians_per_anchor), np.int16),
        scaling=np.zeros((0, SCALINGS), np.int16),
        extra_level=np.zeros(0, np.int16),
        latent=np.zeros((0, LATENTS), np.int16),
        alive=np.zeros(0, np.bool_),
    )


def append_rows(first: AnchorLevel, second: AnchorLevel) -> AnchorLevel:
    """The rows of `first`, then those of `second`."""
    names = AnchorLevel.__slots__
    return AnchorLevel(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


@dataclass(frozen=True, slots=True, eq=False)
class AnchorWeights:
    """The shared network and the latent decoders, fixed until the next keyframe.

    All are float32 arrays whose values are exact in float16, in which they are transmitted.

    Attributes:
        hidden_weight [I,32], hidden_bias [32]: first layer; I = F, plus 4 when the scene is view-dependent.
        output_weight [32,11K], output_bias [11K]: second layer. Columns: K opacities, then 3K colours, 3K scales,
            4K rotations (each Gaussian's values side by side).
        feature_decoder [12,F]: feature latents to feature.
        offset_decoder [12,3K]: offset latents to offsets.
    """

    hidden_weight: Float32
    hidden_bias: Float32
    output_weight: Float32
    output_bias: Float32
    feature_decoder: Float32
    offset_decoder: Float32

    def __post_init__(self) -> None:
        check_array("hidden_weight", self.hidden_weight, (None, HIDDEN), np.float32)
        check_array("hidden_bias", self.hidden_bias, (HIDDEN,), np.float32)
        check_array("output_weight", self.output_weight, (HIDDEN, None), np.float32)
        check_array("output_bias", self.output_bias, (self.output_weight.shape[1],), np.float32)
        check_array("feature_decoder", self.feature_decoder, (FEATURE_LATENTS, None), np.float32)
        check_array("offset_decoder", self.offset_decoder, (OFFSET_LATENTS, None), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class SceneHeader:
    """Facts that a keyframe fixes for all packets that follow it.

    Attributes:
        octree: grid geometry.
        gaussians_per_anchor: K.
        view_dependent: whether the network sees direction and distance.
        reference_distance: d_max, world units (docs/method.md, reading 5).
        position_steps: [L] float32 world units of one position step, for each level.
        feature_steps: [F] float32; offset_steps: [3K] float32; scaling_steps: [6] float32.
        background: [3] float32 RGB in [0, 1] behind everything.
        fps: frames a second of the clip.
        cameras: the rig, offered to viewers as viewpoints; `core.scene.expand.near_radius` goes by them.
    """

    octree: Octree
    gaussians_per_anchor: int
    view_dependent: bool
    reference_distance: float
    position_steps: Float32
    feature_steps: Float32
    offset_steps: Float32
    scaling_steps: Float32
    background: Float32
    fps: float
    cameras: tuple[Camera, ...]

    def __post_init__(self) -> None:
        check_array("position_steps", self.position_steps, (self.octree.levels,), np.float32)
        check_array("feature_steps", self.feature_steps, (None,), np.float32)
        check_array("offset_steps", self.offset_steps, (3 * self.gaussians_per_anchor,), np.float32)
        check_array("scaling_steps", self.scaling_steps, (SCALINGS,), np.float32)
        check_array("background", self.background, (3,), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The complete state of one instant: what a keyframe carries and a decoder holds.

    Attributes:
        header: what is fixed until the next keyframe.
        weights: of the network, likewise.
        levels: one AnchorLevel for each octree level, coarse to fine.
        keyframe: version at which the header and weights were sent.
        version: number of the state in its epoch.
        metadata: facts that the pictures do not depend on.
        identifier: 64 bits that this keyframe shares with no other, of this or another run (`new_identifier`).
    """

    header: SceneHeader
    weights: AnchorWeights
    levels: tuple[AnchorLevel, ...]
    keyframe: int
    version: int
    identifier: int = 0
    metadata: Metadata = NOTHING_KNOWN

    def __post_init__(self) -> None:
        if len(self.levels) != self.header.octree.levels:
            raise ValueError(f"{self.header.octree.levels} levels expected, not {len(self.levels)}")

    @property
    def anchor_count(self) -> int:
        """Anchors alive on all levels."""
        return sum(int(level.alive.sum()) for level in self.levels)


def new_identifier() -> int:
    """64 random bits for a keyframe, so that no packet of another run is taken for one of its own."""
    return secrets.randbits(64)
