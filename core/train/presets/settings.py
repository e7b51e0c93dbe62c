"""Every setting of the method by name, ``part.name``, as command line, REST and configuration file give it.

``model``, ``keyframe`` and ``predict`` are parts of the configuration, and so is each part of later frames. ``parts``
names those that take part, in their order, with ``+`` between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any, get_args, get_type_hints

from streamlod.core.errors import InputError
from streamlod.core.train.config import PartSettings, TrainConfig
from streamlod.core.train.later_frame.parts import USUAL
from streamlod.core.train.paper.preset import OF_LATER_FRAMES

PARTS = {part.name: part for part in (*USUAL, *OF_LATER_FRAMES)}
"""Every part of later frames by name, with its default settings."""
Value = int | float | str | bool
_GROUPS = ("model", "keyframe", "predict")
_LIST = "parts"


def with_settings(config: TrainConfig, changes: Mapping[str, Value]) -> TrainConfig:
    """`config` with some settings changed; the list of parts first, as it says which parts have settings.

    Args:
        changes: values by name, for example ``{"keyframe.steps": 500, "parts": "flow_search+new_anchors"}``.

    Raises:
        InputError: a name that is unknown, with those that are like it; a value of another type or out of bounds.
    """
    if _LIST in changes:
        config = replace(config, parts=_parts_in(changes[_LIST], config))
    for name, value in changes.items():
        if name != _LIST:
            config = _changed(config, name, value)
    return config


def setting_names(config: TrainConfig) -> list[str]:
    """All names that `with_settings` takes for `config`."""
    groups = {name: getattr(config, name) for name in _GROUPS} | {part.name: part for part in config.parts}
    return [_LIST, *(f"{name}.{field.name}" for name, group in groups.items() for field in fields(group))]


def _parts_in(text: Value, config: TrainConfig) -> tuple[PartSettings, ...]:
    """The parts that `text` names, those of `config` with the settings that they have there."""
    known = PARTS | {part.name: part for part in config.parts}
    names = [name for name in str(text).split("+") if name]
    for name in names:
        if name not in known:
            raise InputError(_LIST, f"{name!r:.80} is no part of later frames{_like(name, known)}")
    if len(set(names)) < len(names):
        raise InputError(_LIST, f"{str(text)!r:.80} names a part twice")
    return tuple(known[name] for name in names)


def _changed(config: TrainConfig, name: str, value: Value) -> TrainConfig:
    group, _, setting = name.partition(".")
    if name not in setting_names(config):
        raise _unknown(name, config)
    if group in _GROUPS:
        return replace(config, **{group: _replaced(getattr(config, group), name, setting, value)})
    parts = [_replaced(part, name, setting, value) if part.name == group else part for part in config.parts]
    return replace(config, parts=tuple(parts))


def _unknown(name: str, config: TrainConfig) -> InputError:
    group, _, setting = name.partition(".")
    if group in PARTS and setting in {field.name for field in fields(PARTS[group])}:
        parts = "+".join([*(part.name for part in config.parts), group])
        return InputError(f"setting {name}", f"unknown, as {group} does not take part; it does with parts={parts}")
    known = setting_names(config)
    last = name.rpartition(".")[2]
    alike = [other for other in known if other.rpartition(".")[2] == last]
    near = f"; did you mean {', '.join(alike)}?" if alike else _like(name, known)
    return InputError(f"setting {name!r:.80}", f"unknown{near}")


def _replaced(settings: Any, name: str, setting: str, value: Value) -> Any:
    told = next(field.metadata for field in fields(settings) if field.name == setting)
    return replace(settings, **{setting: _typed(name, get_type_hints(type(settings))[setting], told, value)})


def _typed(name: str, kind: Any, told: Mapping[str, Any], value: Value) -> Value | None:
    """`value` as a setting of the type `kind`: bool, int, float, str, choices of text, or one of these and None.

    Args:
        told: the metadata of `core.train.setting.setting`.
    """
    choices = [*told["choices"], *(choice for choice in get_args(kind) if isinstance(choice, str))]
    kinds = get_args(kind) if not choices and get_args(kind) else (kind,)
    if choices:
        wanted, fits = f"one of {', '.join(choices)}", value in choices
    elif bool in kinds:
        wanted, fits = "true or false", isinstance(value, bool)
    elif str in kinds:
        wanted, fits = "text", isinstance(value, str)
    else:
        whole = int in kinds
        least, most = told["least"], told["most"]
        wanted = f"a {'whole ' if whole else ''}number from {least:g} to {most:.10g}"
        if type(None) in kinds:
            wanted += ", or none"
            if value == "none":
                return None
        fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
        fits = fits and math.isfinite(value) and least <= value <= most  # type: ignore[arg-type]
        if fits and not whole:
            value = float(value)
    if not fits:
        raise InputError(f"setting {name}", f"must be {wanted}, not {value!r:.80}")
    return value


def _like(name: str, known: Any) -> str:
    near = get_close_matches(name, list(known), n=3)
    return f"; did you mean {', '.join(near)}?" if near else f"; choose of {', '.join(sorted(known))}"
