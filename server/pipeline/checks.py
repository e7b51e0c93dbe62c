"""Checks of a job before anything of it runs, so that its maker is told at once what the worker would stumble over."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from streamlod.core.errors import InputError
from streamlod.server.pipeline.job import TrainJob

if TYPE_CHECKING:
    from streamlod.core.synthetic import SyntheticSpec

_SECONDS = 30  # for a process that loads the training library, on a busy machine


def check_job(job: TrainJob) -> None:
    """Refuse settings of the method, a synthetic clip, or a choice of its cameras that cannot be.

    Cameras of recordings and rigs are not looked at, as that means to open them. May take some seconds: the names of
    settings are known to the training library alone, which a process of its own loads.

    Raises:
        InputError: one cannot be; the sentence names it.
    """
    if job.synthetic is not None:
        from streamlod.core.data import training_cameras
        from streamlod.core.synthetic import open_synthetic

        dataset = open_synthetic(synthetic_spec(job.synthetic))
        dataset.select(training_cameras(dataset.names, job.train, job.views, job.test))
    if job.set:
        _check_settings(job.preset, job.set)


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


def _check_settings(preset: str, changes: dict[str, int | float | str | bool]) -> None:
    command = [sys.executable, "-m", "streamlod.server.pipeline.settings_check"]
    given = json.dumps({"preset": preset, "set": changes})
    try:
        done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return  # nothing is known against them; the worker tells
    if done.returncode == 0 and done.stdout:
        subject, fault = json.loads(done.stdout)
        raise InputError(subject, fault)
