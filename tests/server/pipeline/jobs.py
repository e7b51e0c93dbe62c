"""Small jobs that are trained in seconds."""

from __future__ import annotations

from dataclasses import asdict

from streamlod.core.synthetic import SyntheticSpec
from streamlod.server.pipeline.job import TrainJob

SPEC = SyntheticSpec(cameras=5, frames=4, width=32, height=18, seed=2)
JOB = TrainJob(synthetic=asdict(SPEC), test=("cam00",), preset="live")  # with points by a sweep, which takes seconds

FACTS = {"title": "Dance, scene 2", "licence": "CC-BY-4.0"}
