"""Sentences for values that a pydantic model refuses, as `core.options` says it: what fits, and what was given.

Errors are taken as the plain mappings that the library gives out, so that this module does not import it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

_TABLE = "a table of names and values"
_WANTED = {  # by how the type of the error begins
    "int": "a whole number", "float": "a number", "finite": "a finite number", "bool": "true or false",
    "string_type": "text", "path": "text", "list": "a list", "tuple": "a list", "dict": _TABLE, "model": _TABLE,
    "datetime": "an RFC 3339 time, such as 2026-11-26T09:00:00Z",
}  # fmt: skip
_BOUNDED = {  # by the type of the error: words, and the name of the bound
    "greater_than": ("more than", "gt"), "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"), "less_than_equal": ("at most", "le"),
    "string_pattern_mismatch": ("text that matches", "pattern"), "literal_error": ("one of", "expected"),
}  # fmt: skip
_PLAIN = {
    "missing": "is missing, and has to be given",
    "extra_forbidden": "is not known; leave it out, or correct its name",
    "string_too_short": "is too short",
    "string_too_long": "is longer than {max_length} characters",
    "too_short": "has fewer items than {min_length}",
    "too_long": "has more items than {max_length}",
    "json_invalid": "is no JSON ({error})",
    "value_error": "{error}",
}


def first_fault(errors: Sequence[Mapping[str, Any]], skip: int = 0) -> tuple[str, str]:
    """The field that the first of a `ValidationError`'s errors is about, with dots, and what is wrong with it.

    Args:
        skip: parts of the place that are left out, such as the `body` of a request.
    """
    error = errors[0]
    return ".".join(map(str, error["loc"][skip:])), _fault(error)


def matching(pattern: str, words: str) -> Callable[[Any], Any]:
    """For a `BeforeValidator`: refuses texts that do not match, by what is `words`, before their pattern does."""

    def check(value: Any) -> Any:
        if isinstance(value, str) and not re.fullmatch(pattern, value):
            raise ValueError(f"must be {words}, not {value!r:.80}")
        return value

    return check


def _fault(error: Mapping[str, Any]) -> str:
    kind, known = str(error["type"]), error.get("ctx", {})
    if kind in _PLAIN:
        return _PLAIN[kind].format(**known)
    if kind in _BOUNDED:
        words, bound = _BOUNDED[kind]
        return f"must be {words} {known[bound]}, not {error['input']!r:.80}"
    for beginning, wanted in _WANTED.items():
        if kind.startswith(beginning):
            return f"must be {wanted}, not {error['input']!r:.80}"
    return str(error["msg"])
