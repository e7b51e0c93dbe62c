"""Prints docs/reference/api.md from the docstrings of the public interface: `python -m tests.api_pages`."""

from __future__ import annotations

import re
from pathlib import Path

import griffe
from griffe2md import ConfigDict, render_object_docs

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "api.md"
CONFIG: ConfigDict = {
    "docstring_section_style": "list",
    "filters": ["!^_"],
    "heading_level": 2,
    "line_length": 100,
    "separate_signature": True,
    "show_if_no_docstring": False,
    "show_root_full_path": False,
    "show_root_heading": True,
    "show_root_members_full_path": False,
    "show_signature_annotations": True,
    "summary": False,
}
HEAD = """# Python interface

The names of `import streamlod`, printed from their docstrings by `make api`; the programs in `examples/` use them.
"""
LINK = re.compile(r"\[((?:[^\[\]]|\[\])*)\]\(#[^)]*\)")  # to names that have no heading on this page


def page() -> str:
    """The whole page."""
    package = griffe.load("streamlod", search_paths=[str(ROOT)], docstring_parser="google")
    names = sorted(str(name) for name in package.exports or ())
    text = "\n".join(render_object_docs(package[name].final_target, CONFIG) for name in names)
    while LINK.search(text):
        text = LINK.sub(r"\1", text)
    text = re.sub(r"^### `streamlod[\w.]*\.(\w+\.\w+)`$", r"### `\1`", text, flags=re.MULTILINE)
    return HEAD + "\n" + re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
