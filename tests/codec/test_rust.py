"""The decoder in Rust passes the conformance vectors: the document is enough to write one."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.codec.rust import CRATE, outcomes, read_file
from tests.codec.rust import program as built
from tests.fuzz.run_bounded import by_rust, differential
from tests.vectors.make import FOLDER, FROZEN, read_stream

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(shutil.which("cargo") is None, reason="the Rust decoder needs cargo, which is not installed"),
]
MANIFEST: dict[str, Any] = json.loads((FOLDER / "manifest.json").read_text())


@pytest.fixture
def program() -> Path:
    """The program, freshly built."""
    return built()


def test_valid_streams_end_in_the_states_of_the_manifest(program: Path, tmp_path: Path) -> None:
    streams, expected = [], []
    for vector in MANIFEST["valid"]:
        packets = read_stream(FOLDER / vector["file"])
        for count, state in enumerate(vector["states"], 1):
            streams.append(packets[:count])
            expected.append(["", state])
    assert len(streams) > 100
    assert outcomes(program, streams, tmp_path / "streams") == expected


def test_broken_streams_are_refused_and_change_nothing(program: Path, tmp_path: Path) -> None:
    streams = [read_stream(FOLDER / vector["file"]) for vector in MANIFEST["broken"]]
    found = outcomes(program, streams, tmp_path / "streams")
    assert [code for code, _ in found] == [vector["refused"] for vector in MANIFEST["broken"]]
    before = outcomes(program, [stream[:-1] for stream in streams], tmp_path / "before")
    assert [state for _, state in found] == [state for _, state in before]


@pytest.mark.parametrize("vector", MANIFEST["files"], ids=lambda v: v["name"])
def test_files_are_read_as_the_manifest_says(program: Path, vector: dict[str, Any]) -> None:
    found = read_file(program, FOLDER / vector["file"])
    assert {"name": vector["name"], "file": vector["file"], **found} == vector


def test_frozen_recordings_have_the_states_of_the_day(program: Path) -> None:
    for name, recording in json.loads(FROZEN.read_text())["recordings"].items():
        found = read_file(program, FOLDER / name)
        assert found["packets"] == recording["packets"]
        ways = {version: {k: v for k, v in way.items() if k != "numbers"} for version, way in found["ways"].items()}
        assert ways == recording["states"]


def test_it_depends_on_nothing() -> None:
    command = ["cargo", "tree", "--offline", "--prefix", "none"]
    done = subprocess.run(command, cwd=CRATE, capture_output=True, text=True, check=True, timeout=100)
    assert len(done.stdout.splitlines()) == 1


def test_mutants_are_met_as_the_python_decoder_meets_them() -> None:
    """`python -m tests.fuzz.run_bounded rust --count 1000000` does more of it."""
    assert list(differential(by_rust, 60.0, 3, 2000))[-1] >= 500
