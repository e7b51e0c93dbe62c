"""Every option of a stream, in all three places where it can be set: command line, REST, configuration file."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
from pydantic import ValidationError

from streamlod.core.data import LAYOUTS
from streamlod.core.errors import InputError
from streamlod.core.initialise import METHODS
from streamlod.core.options import Option
from streamlod.core.train import preset
from streamlod.server.cli.declared.serving import serve
from streamlod.server.cli.declared.training import train
from streamlod.server.cli.options import TRAINING, takes
from streamlod.server.pipeline.job import JOB_OPTIONS, ONE_LINE, POINT_METHODS, TrainJob
from streamlod.server.pipeline.new_stream import NewStream
from streamlod.server.pipeline.spec import STREAM_OPTIONS, StreamSpec, spec_from_json
from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings, load_settings

PAGE = (Path(__file__).parents[3] / "docs" / "operations.md").read_text()
# One value of each that is no default: as words of the command line, and as JSON.
VALUES: dict[str, tuple[str, Any]] = {
    "id": ("stage", "stage"),
    "play": ("a.slod", "a.slod"),
    "loop": ("", False),
    "on_demand": ("", True),
    "data": ("clip", "clip"),
    "live": ("rig.json", "rig.json"),
    "synthetic": (
        "cameras=5,noise=0.5,still=true,kind=dark", {"cameras": 5, "noise": 0.5, "still": True, "kind": "dark"},
    ),
    "set": ("keyframe.steps=50,model.exposure=false", {"keyframe.steps": 50, "model.exposure": False}),
    "layout": ("colmap", "colmap"),
    "train": ("cam01,cam02", ["cam01", "cam02"]),
    "test": ("cam00", ["cam00"]),
    "views": ("4", 4),
    "frames": ("7", 7),
    "downscale": ("2.5", 2.5),
    "preset": ("quality", "quality"),
    "device": ("cpu", "cpu"),
    "seed": ("3", 3),
    "points": ("random", "random"),
    "keyframe_interval": ("50", 50),
    "frame_budget_ms": ("40", 40.0),
    "target_kbps": ("900", 900.0),
    "title": ("Dance, scene 2", "Dance, scene 2"),
    "licence": ("CC-BY-4.0", "CC-BY-4.0"),
}  # fmt: skip
USAGE = 2  # exit code of options that typer refuses
SOURCES = {"play", "data", "live", "synthetic"}
each_option = pytest.mark.parametrize("option", STREAM_OPTIONS, ids=lambda option: option.name)


def parameters(command: Callable[..., None]) -> dict[str, inspect.Parameter]:
    """The options of a command, as typer is told of them."""
    return dict(inspect.signature(command).parameters)


def from_command_line(*words: str) -> StreamSpec:
    """What `streamlod serve` makes of its options; ValueError if they are refused."""
    found = []
    reader = typer.Typer()

    @reader.command()
    @takes(STREAM_OPTIONS)
    def read(**options: Any) -> None:
        found.append(spec_from_json(options))

    try:
        reader(args=list(words), standalone_mode=False)
    except Exception as error:
        if not isinstance(error, InputError) and getattr(error, "exit_code", None) != USAGE:
            raise
        raise ValueError(str(error)) from error
    return found[0]


def from_rest(body: dict[str, Any]) -> StreamSpec:
    """What `POST /v1/streams` makes of its body; ValueError if it is refused."""
    try:
        return NewStream.model_validate(body).spec
    except (ValidationError, InputError) as error:
        raise ValueError(str(error)) from error


def from_file(folder: Path) -> Callable[[dict[str, Any]], StreamSpec]:
    """Reads a `[[streams]]` table of a configuration file; ValueError if it is refused."""

    def toml(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{name!r} = {toml(item)}" for name, item in value.items()) + "}"
        return str(value).lower() if isinstance(value, bool) else repr(value)

    def read(body: dict[str, Any]) -> StreamSpec:
        path = folder / "server.toml"
        path.write_text("[[streams]]\n" + "".join(f"{name} = {toml(value)}\n" for name, value in body.items()))
        try:
            return load_settings(path).streams[0].spec
        except InputError as error:
            raise ValueError(str(error)) from error

    return read


def words_of(option: Option, text: str) -> list[str]:
    name = f"--{option.name.replace('_', '-')}"
    if bool not in (option.type, *get_args(option.type)):
        return [name, text]
    return [name.replace("--", "--no-", 1) if option.default is True else name]


@cache
def schemas() -> dict[str, dict[str, Any]]:
    """Where an option has to be described: the schema of REST and that of the configuration file."""
    rest = create_app(Settings()).openapi()["components"]["schemas"]["NewStream"]["properties"]
    file = Settings.model_json_schema()["$defs"]["NewStream"]["properties"]
    return {"REST": rest, "configuration file": file}


def test_no_place_has_an_option_of_its_own() -> None:
    declared = {option.name for option in STREAM_OPTIONS}
    assert declared == {field.name for kind in (StreamSpec, TrainJob) for field in fields(kind)} - {"job", "recorded"}
    for place, properties in schemas().items():
        assert set(properties) == declared | {"start"}, place
    server = {
        "host",
        "port",
        "state_dir",
        "config",
        "tokens",
        "metrics_port",
        "trace_endpoint",
        "log_format",
        "insecure",
    }
    assert set(parameters(serve)) - server == declared
    assert set(parameters(train)) - {"data", "out", "json", "trace", "sound"} == {option.name for option in TRAINING}
    assert {option.name for option in JOB_OPTIONS} - {option.name for option in TRAINING} == {
        "data",
        "live",
        "synthetic",
    }


@each_option
def test_help_default_and_bounds_are_the_same_everywhere(option: Option) -> None:
    commands = {serve: option.default}
    if option.name in {each.name for each in TRAINING}:
        commands[train] = TrainJob.__dataclass_fields__[option.name].default
    for command, default in commands.items():
        shown = parameters(command)[option.name]
        told = shown.annotation.__metadata__[0]
        assert told.help == option.help
        assert shown.default == ("" if default == () else default)
        assert (told.min, told.max) == (option.minimum, option.maximum)
    for place, properties in schemas().items():
        described = properties[option.name]
        assert described["description"] == option.help, place
        assert described.get("default") == (list(option.default) if option.default == () else option.default), place
        text = str(described)
        for word, bound in (("minimum", option.minimum), ("maximum", option.maximum)):
            assert (f"'{word}': {bound}" in text) == (bound is not None), (place, word)
        assert [choice for choice in option.choices if choice not in text] == []
    default = {"()": "[]", "None": "none", "True": "true", "False": "false"}.get(str(option.default), option.default)
    assert f"| `{option.name}` | {default} | {option.help} |" in PAGE


@each_option
def test_a_value_means_the_same_everywhere(option: Option, tmp_path: Path) -> None:
    words, value = VALUES[option.name]
    source = [] if option.name in SOURCES else ["--data", "clip"]
    body = ({} if option.name in SOURCES else {"data": "clip"}) | {option.name: value}
    specs = [from_command_line(*source, *words_of(option, words)), from_rest(body), from_file(tmp_path)(body)]
    assert specs[0] == specs[1] == specs[2]
    if option.name not in SOURCES:
        assert specs[0] != spec_from_json({"data": "clip"}), "the value is no default"


@pytest.mark.parametrize("text", ["two\nlines", "bell\a", "end\u2028", "\x85", "\ud800"])
def test_titles_are_one_line(text: str) -> None:
    with pytest.raises(ValueError, match="title"):
        from_rest({"data": "clip", "title": text})
    with pytest.raises(InputError, match="title"):
        TrainJob(data=Path("clip"), title=text)


@each_option
def test_bounds_hold_everywhere(option: Option, tmp_path: Path) -> None:
    beyond: list[Any] = [
        bound + sign for bound, sign in ((option.minimum, -1), (option.maximum, 1)) if bound is not None
    ]
    if option.choices:
        beyond = ["wild"]
    if option.pattern:
        beyond = ["", "x" * 251] if option.pattern == ONE_LINE else ["-", "x" * 65, "Stage"]
    for value in beyond:
        body = {"data": "clip", option.name: value}
        with pytest.raises(ValueError, match=r"."):
            from_command_line("--data", "clip", f"--{option.name.replace('_', '-')}={value}")
        for read in (from_rest, from_file(tmp_path)):
            with pytest.raises(ValueError, match=option.name):
                read(body)
        with pytest.raises(InputError):
            spec_from_json(body)


def test_names_and_paths_are_short(tmp_path: Path) -> None:
    for name, value in (("train", ["cam"] * 257), ("points", "x" * 5000), ("play", "x" * 5000)):
        body = {name: value} if name == "play" else {"data": "clip", name: value}
        for read in (from_rest, from_file(tmp_path), spec_from_json):
            with pytest.raises((ValueError, InputError), match=name):
                read(body)


def test_choices_are_those_of_the_parts_that_they_name() -> None:
    choices = {option.name: option for option in STREAM_OPTIONS}
    assert choices["layout"].choices == LAYOUTS
    with pytest.raises(InputError) as caught:
        preset("wild")
    named = str(caught.value).split("choose one of ")[1]
    assert set(named.split(", ")) == set(choices["preset"].choices)
    assert set(METHODS) <= set(POINT_METHODS)  # else REST takes the name of a method for that of a file, and refuses it
