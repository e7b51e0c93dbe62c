"""The names of `import streamlod`: light to import, complete, typed, and documented as they are."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

import streamlod
from streamlod.core.version import streamlod_version
from tests.api_pages import PAGE, page

ROOT = Path(__file__).parents[1]


def test_importing_the_package_imports_none_of_its_parts() -> None:
    code = "import sys, streamlod; print([n for n in sys.modules if n == 'numpy' or n.startswith('streamlod.')])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("name", streamlod.__all__)
def test_each_name_is_what_its_home_calls_so(name: str) -> None:
    found = getattr(streamlod, name)
    assert found.__name__ == name
    assert found.__doc__


def test_names_that_do_not_exist_are_refused() -> None:
    with pytest.raises(AttributeError, match="'Nothing'"):
        _ = streamlod.Nothing


def test_dir_lists_the_names() -> None:
    assert set(streamlod.__all__) <= set(dir(streamlod))


@pytest.mark.parametrize("argument", ["--version", "version"])
def test_version(argument: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "streamlod.server.cli", argument], cwd=ROOT, capture_output=True, text=True, check=True
    )
    first, *others = done.stdout.splitlines()
    assert first == f"streamlod {streamlod_version()}"
    formats = ["bitstream 1", "viewer protocol 1", f"Python {platform.python_version()}"]
    assert others == ([] if argument == "--version" else formats)


@pytest.mark.long
def test_the_reference_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "docs/reference/api.md: run `make api`"
