"""Values on the command line, as they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import typer
from typer import BadParameter
from typer.testing import CliRunner

from streamlod.core.errors import InputError
from streamlod.server.cli.main import app as commands
from streamlod.server.cli.options import TRAINING, fields_in, takes


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("false", False),
        ("False", "False"),
        ("5", 5),
        ("-3", -3),
        ("0.5", 0.5),
        ("1e-3", 0.001),
        ("2.5E+2", 250.0),
        ("007", "007"),  # an id, perhaps
        ("12e456789012", "12e456789012"),  # of a viewer
        ("NaN", "NaN"),
        ("Infinity", "Infinity"),
        ("9" * 30, "9" * 30),
        ("null", "null"),
        ('"a"', '"a"'),
        ("", ""),
        ("a=b", "a=b"),
    ],
)
def test_values_are_truths_numbers_or_text(text: str, value: object) -> None:
    read = fields_in(f"name={text}")["name"]
    assert (type(read), read) == (type(value), value)


def test_several_fields_and_none() -> None:
    assert fields_in(" cameras=5, still=true ,kind=room") == {"cameras": 5, "still": True, "kind": "room"}
    assert fields_in("") == {}
    with pytest.raises(BadParameter):
        fields_in("cameras")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], None),
        (["--set", "keyframe.steps=3,predict.epochs=1"], {"keyframe.steps": 3, "predict.epochs": 1}),
        (
            ["--set", "keyframe.steps=3,predict.epochs=1", "--set", "keyframe.steps=4"],
            {"keyframe.steps": 4, "predict.epochs": 1},
        ),
    ],
)
def test_settings_that_are_given_in_several_options_all_count(arguments: list[str], expected: object) -> None:
    seen = dict[str, Any]()
    app = typer.Typer()

    @app.command()
    @takes(TRAINING)
    def train(**options: Any) -> None:
        seen.update(options)

    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert seen["set"] == expected


@pytest.mark.parametrize("command", ["file", "serve"])
def test_a_setting_of_the_method_that_is_none_is_refused_at_once(command: str, tmp_path: Path) -> None:
    """With one sentence, wherever it is given: the service does not start, for a stream to fail later."""
    config = tmp_path / "streamlod.toml"
    config.write_text('[[streams]]\nsynthetic = {cameras = 3}\nset = {"keyframe.stps" = 3}\nstart = false\n')
    given = ["--config", str(config)] if command == "file" else ["--synthetic", "cameras=3", "--set", "keyframe.stps=3"]
    refused = CliRunner().invoke(commands, ["serve", "--port", "0", *given])
    assert isinstance(refused.exception, InputError), refused.output
    assert str(refused.exception).startswith("setting 'keyframe.stps': unknown; did you mean keyframe.steps")
