"""Options and arguments of the command line; those of a stream and its training are made from their one declaration."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer

from streamlod.core.errors import InputError
from streamlod.core.options import Option
from streamlod.server.pipeline.job import JOB_OPTIONS, SOURCES

# As in JSON, but bounded, and the sign of an exponent is needed: 123456e12 is the id of a viewer.
_NUMBER = re.compile(r"-?(0|[1-9][0-9]{0,17})(\.[0-9]{1,17})?([eE][-+][0-9]{1,2})?")


def names_in(text: str) -> tuple[str, ...]:
    """Words between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def fields_in(text: str) -> dict[str, int | float | str | bool]:
    """Names and values of ``cameras=5,still=true,kind=room``.

    Numbers are written as in JSON, exponents with their sign; what is neither a number, true nor false is text.

    Raises:
        BadParameter: a part without ``=``.
    """
    found: dict[str, int | float | str | bool] = {}
    for part in names_in(text):
        name, equals, value = part.partition("=")
        if not equals:
            raise typer.BadParameter(f"{part!r} is not NAME=VALUE")
        found[name.strip()] = _value_in(value.strip())
    return found


def _value_in(text: str) -> int | float | str | bool:
    if text in {"true", "false"}:
        return text == "true"
    if _NUMBER.fullmatch(text) is None:
        return text
    return int(text) if text.lstrip("-").isdecimal() else float(text)


def numbers_in(option: str, text: str) -> tuple[int, ...]:
    """Positive whole numbers of ``3,4,5``."""
    words = names_in(text)
    if not words or not all(word.isascii() and word.isdecimal() and 0 < len(word) < 6 and int(word) for word in words):
        raise InputError(option, f"{text!r} is not a list of positive numbers, for example 3,4,5")
    return tuple(dict.fromkeys(int(word) for word in words))


def described(option: Option) -> Any:
    """The form in which typer shows and checks an option."""
    parser: Callable[[str], Any] | None = None
    metavar = option.metavar
    if option.choices:
        parser, metavar = one_of(option.choices), "|".join(option.choices)
    elif _is_list(option):
        parser = partial(numbers_in, f"--{option.name}") if int in get_args(option.type) else names_in
    elif _is_mapping(option):
        parser = fields_in
    return typer.Option(help=option.help, min=option.minimum, max=option.maximum, metavar=metavar, parser=parser)


def takes(options: Iterable[Option]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Let a command take these options in place of its parameter ``**options``, in this order, after its own."""

    def widen(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        own = [each for each in signature.parameters.values() if each.kind is not inspect.Parameter.VAR_KEYWORD]
        keyword = inspect.Parameter.KEYWORD_ONLY
        added = [
            inspect.Parameter(each.name, keyword, default=_default(each), annotation=_annotation(each))
            for each in options
        ]
        mappings = {each.name for each in options if _is_mapping(each)}

        @wraps(command)
        def run(**given: Any) -> None:
            command(**{name: _together(value) if name in mappings else value for name, value in given.items()})

        run.__signature__ = signature.replace(parameters=own + added)  # type: ignore[attr-defined]
        return run

    return widen


def _together(given: list[dict[str, Any]] | None) -> dict[str, Any] | None:
    """The fields of an option that was given once or several times; of one name the last value."""
    return {name: value for fields in given for name, value in fields.items()} if given else None


def one_of(choices: tuple[str, ...]) -> Callable[[str], str]:
    """A parser of one of these words."""

    def choice(text: str) -> str:
        if text not in choices:
            raise typer.BadParameter(f"{text!r} is not one of {', '.join(choices)}")
        return text

    return choice


def _is_list(option: Option) -> bool:
    return get_origin(option.type) is tuple


def _is_mapping(option: Option) -> bool:
    return any(get_origin(kind) is dict for kind in get_args(option.type)) and Path not in get_args(option.type)


def _annotation(option: Option) -> Any:
    return Annotated[_type(option), described(option)]


def _type(option: Option) -> Any:
    """The type that typer is told: what it can convert itself, or the text that a parser takes."""
    if _is_list(option) or get_origin(option.type) is Literal:
        return str
    if _is_mapping(option):
        return list[str] | None
    if Path in get_args(option.type):
        return Path | None
    return option.type


def _default(option: Option) -> Any:
    return ",".join(map(str, option.default)) if _is_list(option) else option.default


_JOB = {option.name: option for option in JOB_OPTIONS}
DEFAULTS: dict[str, Any] = {option.name: option.default for option in JOB_OPTIONS}
TRAINING = tuple(option for option in JOB_OPTIONS if option.name not in SOURCES)
CaFile = Annotated[
    Path | None, typer.Option(metavar="FILE.pem", help="Trust these certificates instead of the system's.")
]
SlodFile = Annotated[Path, typer.Argument(metavar="FILE.slod", help="A recorded bitstream.")]
Data = Annotated[Path, typer.Argument(metavar="DATA", help="Folder of a recording; its layout is detected.")]
Layout = Annotated[str | None, described(_JOB["layout"])]
Device = Annotated[str, described(_JOB["device"])]
Seed = Annotated[int, described(_JOB["seed"])]
Frames = Annotated[int | None, described(_JOB["frames"])]
Host = Annotated[str | None, typer.Option(help="Address to listen on.  [default: 127.0.0.1]")]
Port = Annotated[int | None, typer.Option(min=0, max=65535, help="0 picks a free one.  [default: 8000]")]
Config = Annotated[Path | None, typer.Option(metavar="FILE.toml", help="All settings; options win.")]
Tokens = Annotated[Path | None, typer.Option(metavar="FILE", help="Token file: who may do what.")]
MetricsPort = Annotated[int | None, typer.Option(min=0, max=65535, help="Port of Prometheus metrics.")]
TraceEndpoint = Annotated[
    str | None,
    typer.Option(metavar="http://HOST:PORT", help="OpenTelemetry collector that is told of each frame's way."),
]
Insecure = Annotated[bool, typer.Option("--insecure", help="Allow a public address without tokens.")]
