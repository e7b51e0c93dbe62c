"""Every choice of the method: our value, which is the default, what it means, and the paper's value with its source.

`core.train.presets.named` names other sets of values; the preset `paper` has the paper's (docs/preset-paper.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from streamlod.core.train.setting import given, octree_gs, reading, setting

LevelSelection = Literal["all", "distance"]
Engine = Literal["auto", "autograd", "warp"]


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """The model of a scene: levels, anchors and their numbers."""

    gaussians_per_anchor: int = setting(
        2, "K of each anchor", given(10, "V-A", "K is 10"), least=1, most=16
    )  # more are not decoded (codec/FORMAT.md), nor more features
    features: int = setting(16, "size F of an anchor's feature", octree_gs(32, "its feature size"), least=3, most=64)
    view_dependent: bool = setting(
        False,
        "feed direction and distance to the network",
        given(True, "IV-A", "the network sees viewing distance and direction"),
    )
    cell_pixels: float = setting(
        16.0,
        "width of a level-0 cell as seen from the reference distance, in pixels",
        reading(4.0, "0.001 is given without a unit (docs/method.md, reading 6)"),
        least=1,
    )
    levels: int | None = setting(
        None,
        "number of octree levels; None to derive it from the distances",
        given(None, "IV-A", "L follows from d_max and d_min"),
    )
    finer_levels: int = setting(
        3, "levels beyond those; pictures hold more detail than first points do", given(0, "IV-A", "none beyond L")
    )
    first_cell_pixels: float = setting(
        8.0,
        "least width of a first anchor's cell as seen from its distance, in pixels, where that leaves some thousand;"
        " narrower ones grow where they are needed",
        reading(0.0, "first points fill cells of every level"),
    )
    max_anchors: int = setting(
        128_000,
        "most anchors that there may be",
        reading(40_000, "no limit is given; this one bounds memory"),
        least=16,
        most=1 << 20,
    )
    selection: LevelSelection = setting(
        "all",
        "draw all levels, or per camera only those that its distance calls for",
        given("distance", "IV-A", "a camera's distance selects the levels that are drawn"),
    )
    exposure: bool = setting(
        True,
        "fit a gain and an offset a channel for each training camera; else their differences become haze before them",
        reading(False, "not mentioned, so cameras are taken to agree"),
    )


@dataclass(frozen=True, slots=True)
class KeyframeConfig:
    """Training of the first frame; moments and shares are fractions of the run."""

    steps: int = setting(
        2460,
        "steps of the run",
        reading(1500, "500 epochs (section V-A) of three views (docs/method.md, reading 10)"),
    )
    half_size_until: float = setting(
        0.4,
        "moment until which pictures are smaller, a third of the time a step or less: an eighth, a quarter, then half"
        " of the width and height, as long as 80 rows are left",
        reading(0.0, "not mentioned: pictures of full size from the start"),
    )
    feature_rate: float = setting(
        0.03,
        "Adam's rate of features",
        reading(0.02, "none given; those of Octree-GS are for 40,000 steps (docs/method.md, reading 12)"),
        most=10,
    )
    offset_rate: float = setting(0.06, "Adam's rate of offsets, in cells", reading(0.04, "as feature_rate"), most=10)
    scaling_rate: float = setting(0.045, "Adam's rate of log-scales", reading(0.03, "as feature_rate"), most=10)
    network_rate: float = setting(0.0075, "Adam's rate of the network", reading(0.005, "as feature_rate"), most=10)
    final_rate: float = setting(
        0.1,
        "share of themselves to which rates decay; those of features and scalings to its square root",
        reading(0.1, "as feature_rate"),
    )
    dssim_weight: float = setting(
        0.2, "share of D-SSIM in the loss; the rest is L1", given(0.2, "IV-D", "lambda is 0.2")
    )
    scale_weight: float = setting(
        0.01,
        "weight of the mean volume of the Gaussians in the loss",
        reading(0.01, "equation 10 has no such term, but Octree-GS does (docs/method.md, reading 20)"),
    )
    opacity_weight: float = setting(
        0.06,
        "weight in the loss of the opacity of the Gaussians in view, over the number of all and of cameras less one:"
        " what the pictures do not need fades and is pruned",
        reading(0.0, "not mentioned: equation 10 has no such term"),
    )
    by_support: bool = setting(
        True,
        "whether what fewer cameras see is left out less often, and pays less for its opacity: it has less to agree on",
        reading(False, "not mentioned: all Gaussians alike"),
    )
    random_background: bool = setting(
        True,
        "whether every step draws over another colour where pictures are not black, so that no surface stays half"
        " transparent because what is behind it happens to fit; what is sent has a black background",
        reading(False, "not mentioned: one background"),
    )
    usual_contrast: float = setting(
        0.115,
        "contrast of pictures (mean absolute deviation of their values) below which `opacity_weight` and"
        " `growth_threshold` fall with it, as losses and gradients do; 0: they never fall",
        reading(0.0, "not mentioned: the same for all pictures"),
    )
    usual_pixels: int = setting(
        480 * 270,
        "pixels of a picture above which `growth_threshold` falls with the fourth root of their number: what is one"
        " pixel large pulls less in a larger picture, what is one metre large as much; 0: it never falls",
        reading(0, "not mentioned: the same for all sizes"),
    )
    dropout_base: float = setting(
        0.0,
        "rate gamma = base + slope * level at which Gaussians are left out, ramped over the run",
        given(0.1, "IV-A", "gamma is 0.1 + 0.05 l"),
    )
    dropout_slope: float = setting(0.025, "see `dropout_base`", given(0.05, "IV-A", "gamma is 0.1 + 0.05 l"))
    dropout_cap: float = setting(
        0.5, "largest rate gamma", reading(0.5, "a rate of 1 would draw nothing (docs/method.md, reading 14)")
    )
    progressive_until: float = setting(
        0.0,
        "moment until which levels unlock one after the other; 0: all are there from the start",
        octree_gs(0.25, "levels unlock during 10,000 of its 40,000 steps"),
    )
    level_cap_share: float = setting(
        0.15,
        "share of steps that draw only levels up to a random one",
        reading(0.0, "not mentioned: no step hides fine levels at random"),
    )
    level_cap_weight: float = setting(
        0.2,
        "weight of the loss of such steps until `growth_until`: large gradients of coarse pictures slow Adam down for"
        " the whole one; after that it counts as much as the loss of the last whole picture",
        reading(1.0, "without effect, as no step hides fine levels"),
    )
    growth_interval: int = setting(
        25, "steps between two refinements", given(200, "V-A", "gradients are averaged over 200 steps"), least=1
    )
    growth_from: float = setting(
        0.05,
        "moment from which anchors grow and are pruned",
        octree_gs(0.0375, "refinement begins after 1,500 of its 40,000 steps"),
    )
    growth_until: float = setting(
        0.65, "moment until which they do", octree_gs(0.625, "refinement ends after 25,000 of its 40,000 steps")
    )
    growth_threshold: float = setting(
        2e-4,
        "view-space gradient norm from which anchors are added",
        octree_gs(2e-4, "its threshold of the gradient norm"),
    )
    prune_opacity: float = setting(
        0.005,
        "accumulated opacity below which an anchor is removed",
        given(0.05, "V-A", "an accumulated opacity below 0.05"),
    )
    effect_share: float = setting(
        0.1,
        "share of the squared error that may come when growth ends, as the anchors of least effect go: the others make"
        " up for them; 0: none go",
        reading(0.0, "not mentioned: anchors go by their opacity alone"),
    )
    clearance: float = setting(
        0.6,
        "share of the depth at which first points begin before a camera, nearer than which nothing stays; 0: it may",
        reading(0.0, "not mentioned: anchors may stand anywhere"),
    )
    hiding_weight: float = setting(
        0.001,
        "price of opacity before a view between two cameras, nearer than `clearance` allows, for hiding its whole"
        " picture; less as less is hidden",
        reading(0.0, "not mentioned: no picture shows what hangs there"),
    )
    extra_level_gain: float = setting(
        0.0,
        "levels that an anchor with large gradients earns at a refinement, for `model.selection` by distance",
        octree_gs(0.01, "the size of Delta L"),
    )
    rounding_from: float = setting(
        0.75,
        "moment from which parameters are rounded as they will be sent",
        reading(0.75, "how the first frame is stored is not said; it is rounded as ours is"),
    )
    rounding_share: float = setting(
        0.03,
        "share of the squared error that rounding may add; the steps of each anchor follow from it",
        reading(0.03, "as rounding_from"),
    )
    average_from: float = setting(
        0.8,
        "moment from which steps are averaged for the result; later than `growth_until`",
        reading(1.0, "not mentioned: the result is the last step"),
    )
    refresh_steps: int = setting(
        200,
        "steps of a keyframe in mid-stream, which goes on from the state; 0 sends that as it is",
        reading(0, "not mentioned: no keyframe is trained in mid-stream"),
    )


@dataclass(frozen=True, slots=True)
class PredictConfig:
    """Training of every later frame."""

    epochs: int = setting(16, "passes over the training cameras", given(10, "V-A", "10 epochs"))
    minimum_steps: int = setting(
        120, "fewest steps, however few the cameras", given(0, "V-A", "10 epochs, however few the cameras")
    )
    most_effort: float = setting(
        2.0,
        "where more than a fifth of the pixels changed, at most so many times the steps; up to 1: never more",
        given(1.0, "V-A", "10 epochs, whatever changed"),
    )
    half_size_until: float = setting(
        0.4,
        "moment of the frame, 0 to 1, until which large pictures have half the width and height: a quarter of the time"
        " a step, and what went far is nearer",
        reading(0.0, "not mentioned: pictures of full size from the start"),
    )
    latent_rate: float = setting(
        0.3, "Adam's rate of latents, in steps", reading(0.2, "none given (docs/method.md, reading 12)"), most=1000
    )
    position_rate: float = setting(
        0.2,
        "Adam's rate of positions, in pixels of the camera that shows an anchor largest",
        reading(0.2, "none given (docs/method.md, reading 12)"),
        most=1000,
    )
    memory: float = setting(
        0.6,
        "Adam's beta_1; a few dozen steps are too few for a long one",
        reading(0.9, "none given; the usual one of Adam"),
        most=0.999,
    )
    final_rate: float = setting(
        0.3,
        "share of themselves to which rates decay over the frame",
        reading(0.1, "none given; as in the first frame"),
    )
    average_from: float = setting(
        0.7,
        "moment of the frame, 0 to 1, from which steps are averaged for the result; 1: the result is the last step",
        reading(1.0, "not mentioned: the result is the last step"),
    )
    feature_step: float = setting(
        0.4,
        "width of a latent's step in feature units, in the mean of all directions",
        reading(0.2, "the paper learns its latent decoders; ours are fixed, of this step"),
    )
    offset_step: float = setting(0.15, "width of a latent's step in offset units", reading(0.2, "as feature_step"))
    position_steps_per_cell: int = setting(
        32,
        "steps in which anchors move, to a motion cell: one of the third finest level",
        reading(16, "positions are float32 there; ours are integers, which must be sent"),
        least=1,
    )
    rate_weight: float = setting(
        0.007,
        "weight in the loss of the bits of the residual, divided by the numbers in a picture",
        given(0.0, "IV-D", "the loss has no rate term"),
    )
    dssim_weight: float = setting(
        0.2, "share of D-SSIM in the loss; the rest is L1", given(0.2, "IV-D", "lambda is 0.2")
    )
    changed_weight: float = setting(
        1.25,
        "how much more the absolute error of a pixel counts that has changed: 1 for twice as much as the others",
        given(0.0, "IV-D", "all pixels count alike"),
    )
    cue: str = setting(
        "difference",
        "motion cue, a name in `core.train.motion.cues`",
        given("canonical", "IV-B", "the frame is compared with a rendering of the first"),
        choices=("difference", "canonical", "everything"),
    )
    posterior: float = setting(
        0.05,
        "probability of the mixture's dynamic component, from which an anchor is trained",
        given(0.8, "IV-B", "rho is 80 %"),
    )
    noise_floor: float = setting(
        0.02,
        "smallest change of grey value, in units of [0, 1], that counts as motion",
        reading(0.02, "not mentioned; where no picture changes at all, nothing is trained"),
    )
    engine: Engine = setting(
        "auto",
        "what takes the steps: torch's autograd over the rasteriser of the device, or NVIDIA Warp's recorded kernels;"
        " auto: the latter where Warp draws, as a GPU lacks gsplat",
        reading("auto", "not mentioned"),
    )
    partition_interval: int = setting(
        1,
        "frames between partitions; 4 in the paper's star variant",
        given(1, "IV-D", "every frame is partitioned"),
        least=1,
    )


@dataclass(frozen=True, slots=True)
class PartSettings:
    """Settings of one part of a later frame; `core.train.later_frame.part` says what a part does.

    Attributes:
        name: of the part, by which its settings are reached.
        needs_gradients: whether it asks how the loss pulls at Gaussians in the picture (`core.render.raster.Probe`).
    """

    name: ClassVar[str] = ""
    needs_gradients: ClassVar[bool] = False

    def most_added(self, alive: int) -> int:
        """Anchors that the part may add to a frame of so many."""
        return 0


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """The whole method.

    Attributes:
        parts: of later frames, in the order in which their hooks run (`core.train.later_frame.parts`).
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    predict: PredictConfig = field(default_factory=PredictConfig)
    parts: tuple[PartSettings, ...] = ()
    seed: int = 0
