"""What a stream is made from. Small and plain: it travels to the worker process and lies in the catalogue."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.errors import InputError
from server.pipeline.job import JOB_FIELDS, SOURCES, TrainJob, job_from_json

_ID = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_OWN_FIELDS = frozenset({"id", "play", "loop"})
_PRESET = "live"  # where a stream names none


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """Either `job` or `play` says where packets come from.

    Attributes:
        id: name in URLs: lower-case letters, digits, ``-`` and ``_``.
        job: what to train.
        play: a recorded `.slod` file to stream in real time.
        loop: whether `play` begins again at its end.

    Raises:
        InputError: a bad id, or no single source.
    """

    id: str = "main"
    job: TrainJob | None = None
    play: Path | None = None
    loop: bool = True

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id):
            raise InputError(f"stream {self.id!r:.80}", "an id is 1 to 64 lower-case letters, digits, - or _")
        if (self.job is None) == (self.play is None):
            raise InputError(f"stream {self.id}", "name one source: data, live, synthetic or play")

    @property
    def is_live(self) -> bool:
        """Whether cameras deliver while it trains."""
        return self.job is not None and self.job.live is not None

    def to_json(self) -> dict[str, Any]:
        """Plain values, those of the job among them; `spec_from_json` goes back."""
        own = {"id": self.id, "play": None if self.play is None else str(self.play), "loop": self.loop}
        return own if self.job is None else own | self.job.to_json()


def spec_from_json(values: dict[str, Any]) -> StreamSpec:
    """The specification with these fields of `StreamSpec` and `TrainJob`, side by side.

    Raises:
        InputError: an unknown field, or one that a constructor refuses.
    """
    unknown = sorted(set(values) - JOB_FIELDS - _OWN_FIELDS)
    if unknown:
        raise InputError(f"stream field {unknown[0]!r:.80}", "is not known")
    own = {name: value for name, value in values.items() if name in _OWN_FIELDS}
    if own.get("play") is not None:
        own["play"] = Path(own["play"])
    job = {name: value for name, value in values.items() if name in JOB_FIELDS}
    has_source = any(values.get(name) is not None for name in SOURCES)
    return StreamSpec(**own, job=job_from_json({"preset": _PRESET} | job) if has_source else None)
