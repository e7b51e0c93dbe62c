"""Values on the command line, as they are read."""

from __future__ import annotations

import pytest
from typer import BadParameter

from streamlod.server.cli.options import fields_in


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
