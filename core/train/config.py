"""Every choice of the method, with our value as the default; `core.train.presets` names other sets of values."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

LevelSelection = Literal["all", "distance"]
Heads = Literal["shared", "separate"]


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """What a scene is made of.

    Attributes:
        gaussians_per_anchor: K (paper: 10).
        features: size F of an anchor's feature (paper: 32).
        view_dependent: feed direction and distance to the network (paper: yes).
        cell_pixels: width of a level-0 cell as seen from the reference distance, in pixels.
        levels: number of octree levels, or None to derive it from the distances (paper section IV-A).
        finer_levels: levels beyond those; pictures hold more detail than first points do.
        max_anchors: most anchors of a keyframe.
        selection: draw all levels, or per camera only those that its distance calls for (paper).
        heads: one network for all of a Gaussian's parameters, or separate ones for opacity, colour and shape (F_seps).
        exposure: fit a gain and an offset a channel for each training camera. Without, what cameras disagree on becomes
            haze in front of them.
    """

    gaussians_per_anchor: int = 2
    features: int = 16
    view_dependent: bool = False
    cell_pixels: float = 4.0
    levels: int | None = None
    finer_levels: int = 1
    max_anchors: int = 40_000
    selection: LevelSelection = "all"
    heads: Heads = "shared"
    exposure: bool = True


@dataclass(frozen=True, slots=True)
class KeyframeConfig:
    """Training of the first frame.

    Rates are Adam's, per step; they decay to `final_rate` of themselves over the run (features and scalings to its
    square root). Fractions are of the run.
    """

    steps: int = 1000  # or fewer:
    least_gain: float = 0.0  # of the loss over a fortieth of the run; where it falls by less, the run moves on faster
    half_size_until: float = 0.4  # until then pictures of half the width and height: a third of the time a step
    feature_rate: float = 0.02
    offset_rate: float = 0.04
    scaling_rate: float = 0.03
    network_rate: float = 0.005
    final_rate: float = 0.1
    dssim_weight: float = 0.2
    scale_weight: float = 0.01
    dropout_base: float = 0.05  # gamma = base + slope * level, ramped over the run (paper section IV-A)
    dropout_slope: float = 0.025
    dropout_cap: float = 0.5
    progressive_until: float = 0.0  # levels unlock until this fraction of the run; 0: all from the start
    level_cap_share: float = 0.15  # share of steps that draw only levels up to a random one
    level_cap_weight: float = 0.2  # of their loss: large gradients of coarse pictures slow Adam down for the whole one
    optimiser: str = "adam"  # a name in `core.train.optimise.optimisers`
    growth_rule: str = "gradient"  # a name in `core.train.growth.rules`
    growth_interval: int = 50
    growth_from: float = 0.05
    growth_until: float = 0.65
    growth_threshold: float = 4e-4  # of the view-space gradient norm (paper: 2e-4)
    prune_opacity: float = 0.005
    clearance: float = 0.6  # of the depth at which first points begin before a camera; nothing stays nearer. 0: it may
    extra_level_gain: float = 0.01
    rounding_from: float = 0.75  # from here on the parameters are rounded as they will be sent
    rounding_share: float = 0.03  # of the squared error there, which rounding may add: each anchor's steps follow
    average_from: float = 0.8  # the result is the mean over the steps from here on; after `growth_until`
    refresh_steps: int = 200  # of a keyframe in mid-stream, which goes on from the state; 0 sends that as it is


@dataclass(frozen=True, slots=True)
class PredictConfig:
    """Training of every later frame.

    Attributes:
        epochs: passes over the training cameras (paper: 10).
        minimum_steps: at least so many steps, however few the cameras; or fewer:
        least_gain: where an epoch gains less than this share of what epochs did on average before, the frame moves on
            faster (paper: 0).
        latent_rate, position_rate: Adam rates in steps.
        group_cells: width of the neighbourhoods whose anchors also move as one, in level-0 cells; 0 for none (paper).
        optimiser: a name in `core.train.optimise.optimisers`.
        memory: Adam's beta_1 (usual: 0.9). A few dozen steps are too few for a long one.
        continuation: share of the latest change that an anchor's training begins with, where the one before it pointed
            the same way (paper: 0): what moves mostly goes on.
        final_rate: both decay to this share over the frame.
        feature_step, offset_step: width of a latent's step in feature and offset units.
        rate_weight: weight in the loss of the bits of the residual, divided by the numbers of a picture.
        cue: motion cue, a name in `core.train.motion.cues` (paper: canonical).
        posterior: of the mixture's dynamic component, from which an anchor is taken to move (paper: 0.8).
        changed_posterior: the same, from which an anchor is trained because what it shows has changed, moving or not:
            shadows, reflections, what was uncovered (paper: only what moves).
        noise_floor: smallest change of grey value, in units of [0, 1], that counts as motion.
        partition_interval: frames between partitions (paper's star variant: 4).
        growth_rule: a name in `core.train.growth.rules`.
        growth_at: share of the frame's steps after which anchors are added where Gaussians pull hard.
        growth_threshold: view-space gradient norm from which that happens.
        growth_share: added anchors a frame, at most this share of all; 0 adds none, which measured best.
        everything: treat all anchors as dynamic, for studies.
    """

    epochs: int = 20
    minimum_steps: int = 60
    least_gain: float = 0.3
    latent_rate: float = 0.3
    position_rate: float = 1.4
    group_cells: float = 4.0
    optimiser: str = "adam"
    memory: float = 0.6
    continuation: float = 0.9
    final_rate: float = 0.1
    feature_step: float = 0.2
    offset_step: float = 0.2
    position_steps_per_cell: int = 32
    rate_weight: float = 0.005
    dssim_weight: float = 0.2
    cue: str = "difference"
    posterior: float = 0.2
    changed_posterior: float = 0.05
    noise_floor: float = 0.02
    partition_interval: int = 1
    growth_rule: str = "gradient"
    growth_at: float = 0.3
    growth_threshold: float = 1e-4
    growth_share: float = 0.0
    everything: bool = False


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """The whole method."""

    model: ModelConfig = field(default_factory=ModelConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    predict: PredictConfig = field(default_factory=PredictConfig)
    seed: int = 0
