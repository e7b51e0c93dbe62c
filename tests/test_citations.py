"""Every citation of a file, a module, a section or a document, in code and in documents, leads somewhere."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[1]
TRACKED = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
FILES = {name for name in TRACKED if name and (ROOT / name).is_file()}
FOLDERS = {str(parent) for name in FILES for parent in PurePosixPath(name).parents}
BASENAMES = {PurePosixPath(name).name for name in FILES}
MADE_UP = {"tests/core/render/test_runtime.py"}  # writes a small project of its own
TOP_FOLDERS = "core|codec|client|server|tests|docs|docker|examples"
CODE = sorted(
    name
    for name in FILES - MADE_UP
    if name.endswith((".py", ".js", ".mjs", ".wat", ".wgsl", ".toml")) and name != "tests/test_citations.py"
)
DOCUMENTS = sorted(name for name in FILES if name.endswith(".md"))
BUILT = {"kernel.wasm", "main.js.br", "main.js.gz"}  # made from tracked files

PATH = re.compile(rf"(?<![\w/.:*-])(?:{TOP_FOLDERS})/[\w./-]*[\w/]")
MODULE = re.compile(rf"`+((?:{TOP_FOLDERS})(?:\.\w+)+)`+|python -m (tests(?:\.\w+)+)")
QUOTED_FILE = re.compile(r"`([\w-]+\.(?:py|js|mjs|wat|wgsl|css|html))`")
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} +(.*?)\s*#*$", re.MULTILINE)
# A numbered section, always after the name of its document: "FORMAT.md section 6.2", "RFC 6455 section 5.5".
NUMBER = r"(?:\d+(?:\.\d+)*|[IVX]+(?:-[A-Z])?)"
SECTION = re.compile(
    r"(?:(?P<document>[\w/]+\.md)`?,? |(?P<paper>[Pp]aper,? )|(?P<published>RFC \d+,? |\d{4},? |Thomas, ))?"
    rf"\b[Ss]ections? (?P<numbers>{NUMBER}(?:(?:, | and | to | or ){NUMBER}\b)*)"
)
READING = re.compile(r"(?P<document>[\w/]+\.md)`?,? readings? (?P<numbers>\d+(?:(?:, | and | to | or )\d+)*)")
ELSEWHERE = re.compile(
    r"\b(?:method|codec|server|web|house|style|field|rasteriser) notes\b|\bthe notes\b|\bnotes \d", re.I
)
PAPER_SECTIONS = {"III", "IV-A", "IV-B", "IV-C", "IV-D", "V-A", "V-B", "V-C", "V-D", "V-E", "V-F"}


@cache
def text_of(name: str) -> str:
    """A file's text, with the line breaks inside comments and docstrings as single spaces."""
    return re.sub(r"\s*\n\s*(?:#|//|\*|;;)? *", " ", (ROOT / name).read_text(encoding="utf-8"))


@cache
def headings(name: str) -> tuple[str, ...]:
    text = re.sub(r"```.*?```", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL)
    return tuple(HEADING.findall(text))


def anchors(name: str) -> set[str]:
    """Fragments that a page of the document has, as GitHub makes them."""
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings(name))
    return {heading.replace(" ", "-") for heading in plain}


def document_named(text: str) -> str:
    """The tracked file that a document's name or path in a text means."""
    if text in FILES:
        return text
    found = [name for name in FILES if PurePosixPath(name).name == text]
    assert len(found) == 1, f"{text!r} names {len(found)} files"
    return found[0]


def exists(path: str) -> bool:
    """Whether a path is tracked, as a file, a folder, or a module without its suffix."""
    return path.rstrip("/") in FILES | FOLDERS or f"{path}.py" in FILES or PurePosixPath(path).name in BUILT


def resolves(module: str) -> bool:
    """Whether a dotted name is a module or package, or a name in one."""
    parts = module.split(".")
    for length in range(len(parts), 0, -1):
        path = "/".join(parts[:length])
        if path in FOLDERS and length == len(parts):
            return True
        source = f"{path}.py" if f"{path}.py" in FILES else f"{path}/__init__.py"
        if source in FILES:
            rest = parts[length : length + 1]
            return not rest or re.search(rf"\b{rest[0]}\b", (ROOT / source).read_text(encoding="utf-8")) is not None
    return False


def expanded(numbers: str) -> list[str]:
    """The numbers in "3, 11 and 13", or of the range "16 to 18"."""
    if " to " in numbers and "." not in numbers and numbers[0].isdigit():
        first, last = (int(part) for part in numbers.split(" to "))
        return [str(number) for number in range(first, last + 1)]
    return re.split(r", | and | to | or ", numbers)


def dangling(name: str) -> Iterator[str]:
    """What a file cites that is not there."""
    text = text_of(name)
    yield from (path for path in PATH.findall(text) if not exists(path))
    for found in MODULE.finditer(text):
        module = found[1] or found[2]
        if not resolves(module):
            yield module
    yield from (found for found in QUOTED_FILE.findall(text) if name.endswith(".md") and found not in BASENAMES | BUILT)
    for found in SECTION.finditer(text):
        numbers = expanded(found["numbers"])
        if found["document"]:
            known = {re.split(r"\.? ", heading)[0] for heading in headings(document_named(found["document"]))}
            yield from (f"{found[0]}: {number}" for number in numbers if number not in known)
        elif found["paper"] or numbers[0][0] in "IVX":
            yield from (f"{found[0]}: {number}" for number in numbers if number not in PAPER_SECTIONS)
        elif not found["published"] and name != "codec/FORMAT.md":
            yield f"{found[0]}: of which document?"
    for found in READING.finditer(text):
        rows = re.findall(r"^\| (\d+) \|", (ROOT / document_named(found["document"])).read_text("utf-8"), re.MULTILINE)
        yield from (f"{found[0]}: {number}" for number in expanded(found["numbers"]) if number not in rows)
    yield from (f"{found[0]!r}: not in this repository" for found in ELSEWHERE.finditer(text))


def test_citations_resolve() -> None:
    today = [name for name in CODE + DOCUMENTS if not name.startswith("docs/history/")]  # history names what is gone
    found = {name: list(dangling(name)) for name in today}
    assert {name: citations for name, citations in found.items() if citations} == {}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_resolve(name: str) -> None:
    folder = (ROOT / name).parent
    for found in LINK.finditer((ROOT / name).read_text(encoding="utf-8")):
        target = found[1] or found[2]
        if re.match(r"https?://|mailto:", target):
            continue
        path, _, fragment = target.partition("#")
        file = (folder / path).resolve() if path else ROOT / name
        assert file.exists(), target
        if fragment:
            assert fragment in anchors(str(file.relative_to(ROOT))), target


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("see core/scene/nowhere.py", 1),
        ("see `core.scene.nowhere`", 1),
        ("FORMAT.md section 99", 1),
        ("FORMAT.md sections 6.1 and 6.9", 1),
        ("docs/method.md, readings 1 to 400", 380),
        ("as in section 5", 1),
        ("paper section VII-A", 1),
        ("method notes 8.A row 5", 1),
        ("codec/FORMAT.md section 6.2, docs/method.md, reading 3, and `core.scene.expand`", 0),
    ],
)
def test_what_dangles_is_found(text: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "text_of", lambda name: text)
    assert len(list(dangling("README.md"))) == count
