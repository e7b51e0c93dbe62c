"""Answers of a server by REST, checked: at a wrong address another program answers, or a proxy with its own page.

The fields are those of docs/protocol.md, section 3. Others are ignored, as newer servers may send more.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from streamlod.core.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Answer = TypeVar("_Answer", bound="DataclassInstance")


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """A stream's state; see STREAM of docs/protocol.md. `etag` names what it is made from."""

    id: str
    state: str
    detail: str
    source: str
    epoch: int | None
    version: int | None
    viewers: int
    recording: str
    etag: str | None = None


@dataclass(frozen=True, slots=True)
class ViewerInfo:
    """A viewer; see VIEWER of docs/protocol.md."""

    id: str
    address: str
    client: str
    seconds: float
    mode: str
    sent_bytes: int


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """A recording of one encoder run; see RECORDING of docs/protocol.md."""

    stream: str
    deleted: bool
    epoch: int
    begun_at: datetime
    last_group_at: datetime
    groups: int
    packets: int
    bytes: int


@dataclass(frozen=True, slots=True)
class FeedEvent:
    """One event; see EVENT of docs/protocol.md."""

    id: str
    type: str
    stream: str
    at: datetime
    data: Mapping[str, Any]


def not_ours(fault: str) -> InputError:
    """The error for an answer that no streamlod server gives."""
    return InputError("the server", f"{fault}; this is no streamlod server: check the address and the port")


def object_in(text: bytes | str) -> dict[str, Any]:
    """The JSON object in an answer.

    Raises:
        InputError: there is none.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise not_ours("answers with something else than JSON") from error
    if not isinstance(found, dict):
        raise not_ours("answers with other JSON than an object")
    return found


def items_in(page: dict[str, Any]) -> list[Any]:
    """The list in an answer that is a list, or a page of one.

    Raises:
        InputError: there is none.
    """
    items = page.get("items")
    if not isinstance(items, list):
        raise not_ours("answers without a list of `items`")
    return items


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """The checks for a class, which take a hundred times as long to make as to use."""
    return TypeAdapter(kind)


def read(kind: type[_Answer], values: object) -> _Answer:
    """An instance of one of the classes above, read from JSON.

    Raises:
        InputError: a field is missing or of another type.
    """
    try:
        # strict checks take a time from a string in JSON only, and nothing else from a string anywhere
        found: _Answer = _adapter(kind).validate_json(json.dumps(values), strict=True)
        return found
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        name = ".".join(str(part) for part in first["loc"]) or kind.__name__
        raise not_ours(f"sends a `{name}` that cannot be used ({first['msg']})") from error
