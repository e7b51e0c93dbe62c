"""Options: each described once, beside its field, for the command line, REST and the configuration file alike.

`server.cli.options` makes command-line options of the descriptions, `server.pipeline.new_stream` the model of REST
bodies and of the configuration file. This module imports no library, as `streamlod --help` loads it.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from streamlod.core.errors import InputError

TOKEN_VARIABLE = "STREAMLOD_TOKEN"  # of the environment, which holds the token of whoever runs a command
MAX_CAMERAS = 255  # of a scene header (codec/FORMAT.md), and so of a rig and of a training
PRESETS = ("live", "balanced", "quality", "paper")
_KINDS: dict[Any, str] = {
    **{int: "a whole number", float: "a number", bool: "true or false", str: "text"},
    **{Path: "a path", tuple: "a list of names", dict: "a table of names and values"},
}


@dataclass(frozen=True, slots=True)
class Option:
    """One option as every interface offers it.

    Attributes:
        name: of the field; the command line says ``--some-name`` for ``some_name``.
        type: of the field.
        default: value where none is given.
        help: what it does, in one sentence; with units.
        minimum, maximum: smallest and largest number that is taken.
        max_length: most characters of a text, or items of a list.
        pattern: regular expression that the whole text matches, from ``^`` to ``$``.
        matching: what such a text is, for people.
        choices: the values that are taken, where these are few.
        metavar: what stands for the value in the help of the command line.
        stream_default: default of a stream that is watched while it trains, where it is another than for a file.
    """

    name: str
    type: Any
    default: Any
    help: str
    minimum: float | None = None
    maximum: float | None = None
    max_length: int | None = None
    pattern: str | None = None
    matching: str = ""
    choices: tuple[str, ...] = ()
    metavar: str | None = None
    stream_default: Any = None

    def check(self, value: Any) -> None:
        """Raise InputError if `value` is of another type, or out of bounds."""
        if value is None:
            return
        kinds = get_args(self.type) if get_origin(self.type) is UnionType else (self.type,)
        kinds = tuple(kind for kind in kinds if kind is not NoneType)
        if not any(_is_of(value, kind) for kind in kinds):
            wanted = " or ".join(_KINDS[get_origin(kind) or kind] for kind in kinds)
            raise InputError(self.name, f"must be {wanted}, not {value!r:.80}")
        if isinstance(value, dict):
            self._check_items(value, next(get_args(kind)[1] for kind in kinds if get_origin(kind) is dict))
        if self.choices and value not in self.choices:
            raise InputError(self.name, f"must be one of {', '.join(self.choices)}, not {value!r:.80}")
        if self.minimum is not None or self.maximum is not None:
            low = -math.inf if self.minimum is None else self.minimum
            high = math.inf if self.maximum is None else self.maximum
            if not low <= value <= high:
                raise InputError(self.name, f"must lie between {low:.10g} and {high:.10g}, not {value}")
        if self.pattern is not None and not re.fullmatch(self.pattern, value):
            raise InputError(self.name, f"must be {self.matching}, not {value!r:.80}")
        if self.max_length is not None and len(value if isinstance(value, tuple) else str(value)) > self.max_length:
            raise InputError(self.name, f"is longer than {self.max_length}")

    def _check_items(self, table: dict[str, Any], kind: Any) -> None:
        for name, value in table.items():
            if kind is not Any and not isinstance(value, kind):
                wanted = "a number, text, or true or false"
                raise InputError(self.name, f"{name:.80} must be {wanted}, not {value!r:.80}")


def option(
    default: Any,
    help: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    max_length: int | None = None,
    pattern: str | None = None,
    matching: str = "",
    choices: tuple[str, ...] = (),
    metavar: str | None = None,
    stream_default: Any = None,
) -> Any:
    """A field of a dataclass that is an option; the arguments are those of `Option`."""
    description = {
        "help": help,
        "minimum": minimum,
        "maximum": maximum,
        "max_length": max_length,
        "pattern": pattern,
        "matching": matching,
        "choices": choices,
        "metavar": metavar,
        "stream_default": stream_default,
    }
    return dataclasses.field(default=default, metadata=description)


def _is_of(value: Any, kind: Any) -> bool:
    if get_origin(kind) is tuple:
        return isinstance(value, tuple) and all(isinstance(item, str) for item in value)
    if kind in (int, float) and isinstance(value, bool):
        return False
    return isinstance(value, (int, float) if kind is float else get_origin(kind) or kind)


def test_option() -> Any:
    """The cameras that are held out, in whatever trains."""
    text = "Held-out cameras, never trained on."
    return option((), text, metavar="cam00[,...]", max_length=MAX_CAMERAS)


def downscale_option() -> Any:
    """The size of the pictures, in whatever trains."""
    return option(1.0, "Make pictures so many times smaller.", minimum=1, maximum=64)


def preset_option() -> Any:
    """The preset, in whatever trains; a stream that is watched meanwhile has the fastest by default."""
    text = "What training spends on quality; paper is the published method."
    return option("balanced", text, choices=PRESETS, stream_default="live")


def device_option() -> Any:
    """The device, in whatever trains."""
    return option("auto", "auto takes a CUDA device where there is one.", choices=("auto", "cpu", "cuda"))


def options_of(owner: type) -> tuple[Option, ...]:
    """The options among the fields of a dataclass, in their order."""
    types = get_type_hints(owner)
    return tuple(
        Option(field.name, types[field.name], field.default, **field.metadata)
        for field in dataclasses.fields(owner)
        if field.metadata
    )
