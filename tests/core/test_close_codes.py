"""Close codes: the table of the code, of docs/protocol.md and of the page are the same."""

from __future__ import annotations

import re
from pathlib import Path

from streamlod.core.close_codes import REFUSALS, CloseCode

ROOT = Path(__file__).parents[2]


def test_the_document_lists_them_with_what_to_do() -> None:
    table = (ROOT / "docs" / "protocol.md").read_text().partition("### Close codes")[2].partition("The reason is")[0]
    rows = [re.split(r" *\| *", line.strip("| ")) for line in table.splitlines() if line.startswith("| ")][2:]
    again = {int(code): row[-1] for row in rows for code in row[0].split(" / ")}
    assert set(again) == set(CloseCode)
    assert {code for code, answer in again.items() if answer == "no"} == REFUSALS | {CloseCode.DONE}


def test_the_page_gives_up_after_the_same_ones() -> None:
    source = (ROOT / "client" / "web" / "stream" / "session.js").read_text()
    final = re.search(r"^const FINAL = \{([^}]*)\};$", source, re.MULTILINE)
    assert final is not None
    assert {int(code) for code in re.findall(r"(\d{4}):", final[1])} == REFUSALS | {CloseCode.DONE}
    connection = (ROOT / "client" / "web" / "stream" / "connection.js").read_text()
    bad_message = re.search(r"#refuse\(\) \{[^}]*close\((\d{4}),", connection)
    assert bad_message is not None
    assert int(bad_message[1]) == CloseCode.BAD_MESSAGE


def test_no_other_place_in_python_spells_them_out() -> None:
    for package in ("core", "codec", "server", "client"):
        for path in (ROOT / package).rglob("*.py"):
            if path.name != "close_codes.py":
                assert not re.search(r"(SessionError|[a-z_]*close)\((\w+, )?\d{4}\b", path.read_text()), path
