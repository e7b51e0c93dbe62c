"""Every command that the documents and the benchmarks' docstrings name exists, with each option named beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.main import get_command

from streamlod.server.cli.main import app

ROOT = Path(__file__).parents[1]
HISTORY = ("docs/history/", "CHANGELOG.md")  # name commands as they were then
DOCUMENTS = sorted(
    name
    for pattern in ("*.md", "docs/**/*.md", "core/**/*.md", "codec/*.md", "tests/**/*.py", "Makefile", ".ci/run")
    for path in ROOT.glob(pattern)
    if not (name := path.relative_to(ROOT).as_posix()).startswith((*HISTORY, "tests/test_commands.py"))
)
# In a code span, at the beginning of a line of code, or after what runs it; up to the end of the span or line.
COMMAND = re.compile(
    r"(?:`|^ {4,}|^\t|^|/bin/)(?P<command>streamlod [a-z][^`\n]*|python3? -m tests\.[^`\n]*)", re.MULTILINE
)
OPTION = re.compile(r"(?<=[\s\[])--[a-z][a-z-]*")
EVERYWHERE = {"--help", "--debug", "--verbose"}
PROGRAMS = dict(vars(get_command(app))["commands"])


def without_comment(command: str) -> str:
    """The command alone: no shell comment, no pipe, no second command."""
    return re.split(r"\s[#|&]|;|\s{3,}", command)[0]


def in_fences(text: str) -> str:
    """Prose that begins with the program's name is no command: only indented lines, code spans and fences count."""
    fenced = re.findall(r"```[a-z]*\n(.*?)```", text, re.DOTALL)
    indented = re.findall(r"^(?: {4,}|\t)\S.*$", text, re.MULTILINE)
    spans = re.findall(r"`[^`\n]+`", text)
    return "\n".join([*fenced, *indented, *spans])


def commands(name: str) -> Iterator[str]:
    for found in COMMAND.finditer(in_fences((ROOT / name).read_text(encoding="utf-8"))):
        yield without_comment(found["command"]).strip()


def faults(command: str) -> Iterator[str]:
    """What the command names and does not exist."""
    words, options = command.split(), set(OPTION.findall(command)) - EVERYWHERE
    if words[0] == "streamlod" and words[1] == "bench":
        if len(words) > 2:
            yield from missing(f"tests.bench.{words[2].replace('-', '_')}_bench", options)
    elif words[0] == "streamlod":
        program = PROGRAMS.get(words[1])
        if program is None:
            yield f"there is no command {words[1]}"
        else:
            yield from sorted(options - {option for each in program.params for option in each.opts})
    else:
        yield from missing(words[2], options)


def missing(module: str, options: set[str]) -> Iterator[str]:
    """Options that the source of a module, run as a program, does not declare."""
    path = ROOT / (module.replace(".", "/") + ".py")
    if not path.is_file():
        yield f"there is no module {module}"
        return
    texts = [path.read_text(encoding="utf-8")]
    if "tests.bench.parts import" in texts[0]:
        texts.append((ROOT / "tests/bench/parts.py").read_text(encoding="utf-8"))
    yield from sorted(options - {option for text in texts for option in re.findall(r"\"(--[a-z-]+)\"", text)})


@pytest.mark.parametrize("name", [name for name in DOCUMENTS if any(commands(name))])
def test_commands_exist(name: str) -> None:
    found = {command: list(faults(command)) for command in commands(name)}
    assert {command: wrong for command, wrong in found.items() if wrong} == {}


def test_commands_are_found() -> None:
    assert {command.split()[1] for command in commands("README.md")} > {"demo", "train", "serve", "push"}


@pytest.mark.parametrize(
    ("command", "wrong"),
    [
        ("streamlod trian DATA", 1),
        ("streamlod train DATA --presets live", 1),
        ("streamlod train DATA --preset live --debug", 0),
        ("streamlod bench nothing", 1),
        ("python -m tests.bench.web_bench --drop", 1),
        ("python -m tests.bench.web_bench --drag", 0),
    ],
)
def test_what_does_not_exist_is_found(command: str, wrong: int) -> None:
    assert len(list(faults(command))) == wrong
