"""The preset `paper`: every setting given, and where each comes from.

Nothing is taken from our defaults, so that tuning ours never moves the baseline. docs/preset-paper.md shows this
table; a test compares the two, and fails where a setting is added without an entry here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig


@dataclass(frozen=True, slots=True)
class Choice:
    """One setting.

    Attributes:
        value: of the field.
        section: of the paper that gives it, empty where we had to read it into the paper.
        why: what the paper says, or why we read it so.
    """

    value: Any
    section: str
    why: str


def _given(value: Any, section: str, what: str) -> Choice:
    return Choice(value, section, what)


def _octree(value: Any, what: str) -> Choice:
    """A value of Octree-GS, which the paper takes for everything that it does not name (section V-A)."""
    return Choice(value, "V-A", f"the rest is as in Octree-GS: {what}")


def _reading(value: Any, why: str) -> Choice:
    return Choice(value, "", why)


MODEL = {
    "gaussians_per_anchor": _given(10, "V-A", "K is 10"),
    "features": _octree(32, "its feature size"),
    "view_dependent": _given(True, "IV-A", "the network sees viewing distance and direction"),
    "cell_pixels": _reading(4.0, "0.001 is given without a unit (docs/method.md, reading 6)"),
    "levels": _given(None, "IV-A", "L follows from d_max and d_min"),
    "finer_levels": _given(0, "IV-A", "none beyond L"),
    "max_anchors": _reading(40_000, "no limit is given; this one bounds memory"),
    "selection": _given("distance", "IV-A", "a camera's distance selects the levels that are drawn"),
    "heads": _given("shared", "IV-A", "one shared network"),
    "exposure": _reading(False, "not mentioned, so cameras are taken to agree"),
}

KEYFRAME = {
    "steps": _reading(1500, "500 epochs (section V-A) of three views (docs/method.md, reading 10)"),
    "least_gain": _given(0.0, "V-A", "the number of epochs is fixed"),
    "half_size_until": _reading(0.0, "not mentioned: pictures of full size from the start"),
    "feature_rate": _reading(0.02, "none given; those of Octree-GS are for 40,000 steps (docs/method.md, reading 12)"),
    "offset_rate": _reading(0.04, "as feature_rate"),
    "scaling_rate": _reading(0.03, "as feature_rate"),
    "network_rate": _reading(0.005, "as feature_rate"),
    "final_rate": _reading(0.1, "as feature_rate"),
    "dssim_weight": _given(0.2, "IV-D", "lambda is 0.2"),
    "scale_weight": _reading(0.01, "equation 10 has no such term, but Octree-GS does (docs/method.md, reading 20)"),
    "dropout_base": _given(0.1, "IV-A", "gamma is 0.1 + 0.05 l"),
    "dropout_slope": _given(0.05, "IV-A", "gamma is 0.1 + 0.05 l"),
    "dropout_cap": _reading(0.5, "a rate of 1 would draw nothing (docs/method.md, reading 14)"),
    "progressive_until": _octree(0.25, "levels unlock during 10,000 of its 40,000 steps"),
    "level_cap_share": _reading(0.0, "not mentioned: no step hides fine levels at random"),
    "level_cap_weight": _reading(1.0, "without effect, as no step hides fine levels"),
    "optimiser": _octree("adam", "its optimiser"),
    "growth_rule": _octree("gradient", "its refinement"),
    "growth_interval": _given(200, "V-A", "gradients are averaged over 200 steps"),
    "growth_from": _octree(0.0375, "refinement begins after 1,500 of its 40,000 steps"),
    "growth_until": _octree(0.625, "refinement ends after 25,000 of its 40,000 steps"),
    "growth_threshold": _octree(2e-4, "its threshold of the gradient norm"),
    "clearance": _reading(0.0, "not mentioned: anchors may stand anywhere"),
    "prune_opacity": _given(0.05, "V-A", "an accumulated opacity below 0.05"),
    "extra_level_gain": _octree(0.01, "the size of Delta L"),
    "rounding_from": _reading(0.75, "how the first frame is stored is not said; it is rounded as ours is"),
    "rounding_share": _reading(0.03, "as rounding_from"),
    "average_from": _reading(1.0, "not mentioned: the result is the last step"),
    "refresh_steps": _reading(0, "not mentioned: no keyframe is trained in mid-stream"),
}

PREDICT = {
    "epochs": _given(10, "V-A", "10 epochs"),
    "minimum_steps": _given(0, "V-A", "10 epochs, however few the cameras"),
    "least_gain": _given(0.0, "V-A", "the number of epochs is fixed"),
    "latent_rate": _reading(0.2, "none given (docs/method.md, reading 12)"),
    "position_rate": _reading(1.0, "none given (docs/method.md, reading 12)"),
    "group_cells": _reading(0.0, "not mentioned: every anchor moves by itself"),
    "optimiser": _octree("adam", "its optimiser"),
    "memory": _reading(0.9, "none given; the usual one of Adam"),
    "continuation": _reading(0.0, "not mentioned: training begins at the frame before"),
    "final_rate": _reading(0.1, "none given; as in the first frame"),
    "feature_step": _reading(0.2, "the paper learns its latent decoders; ours are fixed, of this step"),
    "offset_step": _reading(0.2, "as feature_step"),
    "position_steps_per_cell": _reading(16, "positions are float32 there; ours are integers, which must be sent"),
    "rate_weight": _given(0.0, "IV-D", "the loss has no rate term"),
    "dssim_weight": _given(0.2, "IV-D", "lambda is 0.2"),
    "cue": _given("canonical", "IV-B", "the frame is compared with a rendering of the first"),
    "posterior": _given(0.8, "IV-B", "rho is 80 %"),
    "changed_posterior": _given(1.0, "IV-B", "only what moves is trained"),
    "noise_floor": _reading(0.02, "not mentioned; where no picture changes at all, nothing is trained"),
    "partition_interval": _given(1, "IV-D", "every frame is partitioned"),
    "growth_rule": _octree("gradient", "its refinement"),
    "growth_at": _reading(0.3, "after 30 steps (section V-A), a whole frame of three views, nothing added is trained"),
    "growth_threshold": _octree(2e-4, "its threshold of the gradient norm"),
    "growth_share": _reading(0.01, "no limit is given; this one bounds a packet"),
    "everything": _given(False, "IV-B", "static anchors are frozen"),
}


def paper() -> TrainConfig:
    """The configuration that the tables above describe."""
    return TrainConfig(
        ModelConfig(**_values(MODEL)), KeyframeConfig(**_values(KEYFRAME)), PredictConfig(**_values(PREDICT)), seed=0
    )


def paper_table() -> str:
    """The tables as Markdown."""
    lines = ["| setting | value | source | what it says, or why we read it so |", "| --- | --- | --- | --- |"]
    for part, table in (("model", MODEL), ("keyframe", KEYFRAME), ("predict", PREDICT)):
        for name, choice in table.items():
            source = f"paper, section {choice.section}" if choice.section else "our reading"
            lines.append(f"| `{part}.{name}` | {choice.value} | {source} | {choice.why} |")
    return "\n".join(lines) + "\n"


def _values(table: Mapping[str, Choice]) -> dict[str, Any]:
    return {name: choice.value for name, choice in table.items()}
