"""The points of a trade-off sweep: one setting at a time varied from a base, and the presets."""

from __future__ import annotations

from dataclasses import dataclass, replace

from streamlod.client.evaluation.systems import with_coarser_steps
from streamlod.core.train import PRESETS, KeyframeConfig, ModelConfig, PredictConfig, TrainConfig, preset

BASE = "balanced"


@dataclass(frozen=True, slots=True)
class Point:
    """A configuration to measure.

    Attributes:
        name: in tables and plots. knob: the setting that was varied, or ``preset``.
        shrink: how many times smaller than the held-out pictures the training pictures are.
    """

    name: str
    knob: str
    config: TrainConfig
    shrink: float = 1.0


def one_at_a_time() -> tuple[Point, ...]:
    """The presets, then each setting at values other than the base's."""
    base = preset(BASE)
    points = [Point(name, "preset", preset(name)) for name in PRESETS]
    turned = [
        *(_later("epochs", n, replace(base.predict, epochs=n, minimum_steps=3 * n)) for n in (5, 10, 40)),
        *(_later("rate weight", w, replace(base.predict, rate_weight=w)) for w in (0.0, 0.003, 0.03)),
        *(Point(f"step {f:g}", "step", with_coarser_steps(base, f)) for f in (0.5, 2.0)),
        *(_later("partition every", n, replace(base.predict, partition_interval=n)) for n in (2, 4)),
        *(_model("levels", n, replace(base.model, levels=n, finer_levels=0, cell_pixels=4.0)) for n in (1, 3, 5)),
        *(_model("K", n, replace(base.model, gaussians_per_anchor=n)) for n in (1, 4)),
        *(_model("anchors", n, replace(base.model, max_anchors=n)) for n in (8_000, 15_000)),
        *(_first("growth from", t, replace(base.keyframe, growth_threshold=t)) for t in (1.3e-4, 2.65e-4, 5.3e-4)),
        *(_first("first steps", n, _longer(base.keyframe, n)) for n in (500, 2000)),
        *(Point(f"downscale {f:g}", "downscale", base, f) for f in (1.5, 2.0)),
    ]
    return (*points, *(point for point in turned if point.config != base or point.shrink != 1))


def _longer(keyframe: KeyframeConfig, steps: int) -> KeyframeConfig:
    interval = max(round(keyframe.growth_interval * steps / keyframe.steps), 1)
    return replace(keyframe, steps=steps, growth_interval=interval)


def _later(knob: str, value: float, predict: PredictConfig) -> Point:
    return Point(f"{knob} {value:g}", knob, replace(preset(BASE), predict=predict))


def _model(knob: str, value: float, model: ModelConfig) -> Point:
    return Point(f"{knob} {value:g}", knob, replace(preset(BASE), model=model))


def _first(knob: str, value: float, keyframe: KeyframeConfig) -> Point:
    return Point(f"{knob} {value:g}", knob, replace(preset(BASE), keyframe=keyframe))
