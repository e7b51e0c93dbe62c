"""The options of a stream as a pydantic model, for REST bodies and the configuration file."""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BeforeValidator, ConfigDict, Field, StrictBool, create_model

from streamlod.core.errors import InputError
from streamlod.core.options import Option
from streamlod.server.pipeline.job import SOURCES
from streamlod.server.pipeline.spec import STREAM_OPTIONS, StreamSpec, spec_from_json

_SOURCES = (*SOURCES, "play")


def _json_type(kind: Any) -> Any:
    """The type of an option as JSON and TOML have it: paths are texts, tuples are lists."""
    if kind is Path:
        return str
    if get_origin(kind) is UnionType:
        return reduce(operator.or_, map(_json_type, get_args(kind)))
    if get_origin(kind) is tuple:
        return list[str]
    return kind


def _change(option: Option) -> Any:
    """The field of a change: absent or null by default."""
    kind, field = _field(option)
    field.default = None
    return kind | None, field


def _field(option: Option) -> Any:
    """Type and description of an option, as `create_model` takes them."""
    kind = _json_type(option.type)
    if option.choices:
        choice: Any = Literal.__getitem__(option.choices)
        kind = choice | None if option.default is None else choice
    default = list(option.default) if isinstance(option.default, tuple) else option.default
    bounds = {
        "ge": option.minimum,
        "le": option.maximum,
        "max_length": option.max_length,
        "pattern": option.pattern,
    }
    given: dict[str, Any] = {name: bound for name, bound in bounds.items() if bound is not None}
    return Annotated[kind, BeforeValidator(_check(option))], Field(default=default, description=option.help, **given)


def _check(option: Option) -> Callable[[Any], Any]:
    """Refuses a value of JSON or TOML in the option's own words, before pydantic would take another type for it."""

    def check(value: Any) -> Any:
        is_path = isinstance(value, str) and Path in (option.type, *get_args(option.type))
        given = Path(value) if is_path else tuple(value) if isinstance(value, list) else value
        try:
            option.check(given)
        except InputError as error:
            raise ValueError(error.fault) from error
        return value

    return check


_StreamOptions = create_model("_StreamOptions", **{option.name: _field(option) for option in STREAM_OPTIONS})


class NewStream(_StreamOptions):  # type: ignore[misc, valid-type]
    """A stream to create: exactly one of `data`, `live`, `play` and `synthetic`."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"id": "stage", "synthetic": {"cameras": 5, "frames": 30}, "start": True}]},
    )

    start: StrictBool | None = Field(
        default=None, description="Start it at once; by default streams of the settings file do, others do not."
    )

    @property
    def spec(self) -> StreamSpec:
        """The specification of the stream; InputError if it cannot be made."""
        return spec_from_json(self.model_dump(exclude={"start"}, exclude_none=True))


_StreamChanges = create_model(
    "_StreamChanges", **{option.name: _change(option) for option in STREAM_OPTIONS if option.name != "id"}
)


class StreamChange(_StreamChanges):  # type: ignore[misc, valid-type]
    """Fields of a stream that are to be changed; a new source replaces the old one."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"on_demand": True}]})

    def apply_to(self, spec: StreamSpec) -> StreamSpec:
        """The changed specification; InputError if there can be none."""
        changes = self.model_dump(exclude_unset=True)
        values = spec.to_json() | changes
        if any(changes.get(name) is not None for name in _SOURCES):
            values |= {name: changes.get(name) for name in _SOURCES}
        return spec_from_json({name: value for name, value in values.items() if value is not None})
