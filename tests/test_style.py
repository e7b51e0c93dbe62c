"""Words and form that CONTRIBUTING.md asks for, in documents and docstrings."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TRACKED = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
GENERATED = {"docs/reference/api.md", "docs/preset-paper.md"}
LOOSE = GENERATED | {"codec/FORMAT.md"}  # the last is frozen as it is
DOCUMENTS = [name for name in TRACKED if name.endswith(".md") and name not in LOOSE]
MODULES = [
    name
    for name in TRACKED
    if name.endswith(".py") and name.startswith(("core/", "codec/", "client/", "server/", "streamlod/"))
]
MAX_WIDTH = 120
UNBREAKABLE = re.compile(r"\]\(|https?://|<code>|`[^`]{60,}`|^`[^`]+$")  # links, addresses, commands
HEADLESS = re.compile(r"(What|Of|As|One of)\b")  # a docstring's first word: it leaves out what it speaks of
LATER = ("core/train/",)  # rewritten meanwhile


def too_long(text: str) -> list[str]:
    """Lines of prose that are too long."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith(("|", "    "))]
    return [line for line in lines if len(line) > MAX_WIDTH and not UNBREAKABLE.search(line)]


@pytest.mark.parametrize("name", DOCUMENTS)
def test_documents_are_wrapped(name: str) -> None:
    assert too_long((ROOT / name).read_text(encoding="utf-8")) == []


def headless(source: str) -> list[str]:
    """First lines of docstrings that begin without a subject."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    found = (ast.get_docstring(node) for node in ast.walk(ast.parse(source)) if isinstance(node, owners))
    return [text.splitlines()[0] for text in found if text and HEADLESS.match(text)]


def test_docstrings_begin_with_a_subject() -> None:
    held = [name for name in MODULES if not name.startswith(LATER)]
    found = {name: headless((ROOT / name).read_text(encoding="utf-8")) for name in held}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_what_is_headless_is_found() -> None:
    source = '''
def f():
    """What it holds."""

class A:
    """Of n anchors."""

    def g(self):
        """Whatever."""
'''
    assert headless(source) == ["What it holds.", "Of n anchors."]
