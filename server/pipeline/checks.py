"""Checks of a job before anything of it runs, so that its maker is told at once what the worker would stumble over."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from streamlod.core.errors import InputError
from streamlod.core.train.presets.named import PRESETS
from streamlod.core.train.presets.settings import with_settings
from streamlod.server.pipeline.job import TrainJob

if TYPE_CHECKING:
    from streamlod.core.synthetic import SyntheticSpec


def check_job(job: TrainJob) -> None:
    """Refuse settings of the method, a synthetic clip, or a choice of its cameras that cannot be.

    Cameras of recordings and rigs are not looked at, as that means to open them.

    Raises:
        InputError: one cannot be; the sentence names it.
    """
    if job.synthetic is not None:
        from streamlod.core.data import training_cameras
        from streamlod.core.synthetic import open_synthetic

        dataset = open_synthetic(synthetic_spec(job.synthetic))
        dataset.select(training_cameras(dataset.names, job.train, job.views, job.test))
    if job.set:
        with_settings(PRESETS[job.preset], job.set)


def synthetic_spec(values: dict[str, Any]) -> SyntheticSpec:
    """The synthetic clip with these fields; InputError for one that it does not have, or a value of another type."""
    from streamlod.core.synthetic import SyntheticSpec

    kinds = {field.name: type(field.default) for field in fields(SyntheticSpec)}
    for name, value in values.items():
        if name not in kinds:
            raise InputError("synthetic clip", f"has no field {name!r:.80}; it has {', '.join(kinds)}")
        kind = kinds[name]
        fits = type(value) is kind or (kind is float and type(value) is int)
        if not fits:
            raise InputError("synthetic clip", f"{name} must be of type {kind.__name__}, not {value!r:.80}")
    return SyntheticSpec(**values)
