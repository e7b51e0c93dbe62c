"""Specifications of streams: plain values, which are sent to the worker process and kept in `stream.json`."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from streamlod.core.errors import InputError
from streamlod.core.options import option, options_of
from streamlod.server.pipeline.job import JOB_FIELDS, JOB_OPTIONS, MAX_PATH, SOURCES, TrainJob

STREAM_ID = "^[a-z0-9][a-z0-9_-]{0,63}$"
_ID_WORDS = "1 to 64 lower-case letters, digits, - or _"


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """Either `job`, what to train, or `play` says where packets come from; the help of the other fields says the rest.

    Raises:
        InputError: a bad id, no single source, or a value out of bounds.
    """

    id: str = option("main", f"Name in addresses: {_ID_WORDS}.", pattern=STREAM_ID, matching=_ID_WORDS)
    job: TrainJob | None = None
    play: Path | None = option(
        None,
        "Stream a recorded file in real time (on the command line also .ply, .spz, .glb, .4dgs).",
        metavar="FILE.slod",
        max_length=MAX_PATH,
    )
    loop: bool = option(True, "Begin a played file again at its end.")
    on_demand: bool = option(False, "Start with the first viewer, and stop some time after the last one.")
    recorded: bool = True  # in the state folder, of a file once; not what `serve --play` plays, as it is a recording

    def __post_init__(self) -> None:
        if not re.fullmatch(STREAM_ID, self.id):
            raise InputError(f"stream {self.id!r:.80}", f"an id is {_ID_WORDS}")
        for each in _OWN_OPTIONS:
            each.check(getattr(self, each.name))
        if (self.job is None) == (self.play is None):
            raise InputError(f"stream {self.id}", "name one source: data, live, synthetic or play")

    @property
    def is_live(self) -> bool:
        """Whether cameras deliver while it trains."""
        return self.job is not None and self.job.live is not None

    @property
    def source(self) -> Literal["cameras", "data", "recording"]:
        """The kind of source: live cameras, pictures taken earlier that are trained now, or a recorded bitstream."""
        if self.play is not None:
            return "recording"
        return "cameras" if self.is_live else "data"

    def to_json(self) -> dict[str, Any]:
        """Plain values, those of the job among them; `spec_from_json` goes back."""
        own = {"id": self.id, "play": None if self.play is None else str(self.play), "loop": self.loop}
        own["on_demand"] = self.on_demand
        return own if self.job is None else own | self.job.to_json()


_OWN_OPTIONS = options_of(StreamSpec)
_OWN_FIELDS = frozenset(each.name for each in _OWN_OPTIONS)
_STREAM_DEFAULTS = {each.name: each.stream_default for each in JOB_OPTIONS if each.stream_default is not None}
STREAM_OPTIONS = _OWN_OPTIONS + tuple(
    replace(each, default=_STREAM_DEFAULTS.get(each.name, each.default)) for each in JOB_OPTIONS
)  # of a stream, with the defaults of one that is watched while it trains


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
    return StreamSpec(**own, job=TrainJob(**_STREAM_DEFAULTS | job) if has_source else None)
