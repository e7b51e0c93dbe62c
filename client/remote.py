"""The command `streamlod remote`: manage a server's streams from a terminal; yields the lines to print."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from streamlod.client.rest import ServerClient
from streamlod.core.errors import InputError
from streamlod.core.options import TOKEN_VARIABLE

_Value = TypeVar("_Value", bool, int)
ALONE = ("list", "recordings", "server", "events")  # actions that need no stream
ACTIONS = (*ALONE, "show", "create", "change", "start", "stop", "delete", "viewers", "disconnect", "download")
_OPTIONS = {
    "delete": {"erase"},
    "disconnect": {"viewer"},
    "download": {"from", "to", "epoch"},
    "recordings": {"from", "to"},
}
_DESCRIBING = ("create", "change")  # actions whose options describe the stream; the server checks them


def remote(
    address: str,
    action: str,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
    out: Path | None = None,
    ca: Path | None = None,
) -> Iterator[str]:
    """Do something on a server and give the lines to print.

    Args:
        name: of the stream.
        options: fields of the stream to create or change; ``erase`` of its deletion; ``viewer`` to disconnect;
            ``from`` and ``to`` of a download or a list of recordings, ``epoch`` of a download.
        out: the file of a download.
        ca: certificates to trust.

    Raises:
        InputError: an option that the action does not have or cannot use, or no usable answer.
        RequestRefused: by the server.
    """
    if action not in ACTIONS:
        raise InputError("remote", f"{action} is none of {', '.join(ACTIONS)}")
    if name is None and action not in ALONE:
        raise InputError("remote", f"{action} needs the id of a stream")
    given = dict(options or {})
    if action not in _DESCRIBING and (unknown := sorted(given.keys() - _OPTIONS.get(action, set()))):
        raise InputError("--set", f"{action} does not take {', '.join(unknown):.80}")
    with ServerClient(address, os.environ.get(TOKEN_VARIABLE), ca) as server:
        yield from _lines(server, action, name or "", given, out)


def _lines(server: ServerClient, action: str, name: str, options: dict[str, Any], out: Path | None) -> Iterator[str]:
    begin, end = _time(options, "from"), _time(options, "to")
    lists: dict[str, Callable[[], Iterable[Any]]] = {
        "list": server.streams,
        "recordings": lambda: server.recordings(begin, end),
        "events": lambda: server.events(name or None),
        "viewers": lambda: server.viewers(name),
        "create": lambda: [server.create(name, options)],
        "change": lambda: [server.change(name, options)],
        "start": lambda: [server.start(name)],
        "stop": lambda: [server.stop(name)],
    }
    if action in lists:
        for found in lists[action]():
            yield json.dumps(asdict(found), default=str)
    elif action in {"server", "show"}:
        yield json.dumps(server.server() if action == "server" else server.definition(name), indent=1)
    elif action == "delete":
        server.delete(name, erase=_option(options, "erase", bool, "true or false") or False)
    elif action == "disconnect":
        if "viewer" not in options:
            raise InputError("--set viewer", "say which viewer to disconnect, by the id that `viewers` lists")
        server.disconnect(name, str(options["viewer"]))
    else:
        path = out or Path(f"{name}.slod")
        size = server.download(name, path, begin, end, _option(options, "epoch", int, "a number, such as 1"))
        yield f"{path}: {size / 1000:.1f} KB"


def _option(options: dict[str, Any], name: str, kind: type[_Value], form: str) -> _Value | None:
    """An option, None if it is not given; not converted, because bool("false") is True."""
    value = options.get(name)
    if value is None or type(value) is kind:
        return value
    raise InputError(f"--set {name}", f"{value!r:.80} is not {form}")


def _time(options: dict[str, Any], name: str) -> datetime | None:
    text = options.get(name)
    try:
        return None if text is None else datetime.fromisoformat(str(text))
    except ValueError as error:
        raise InputError(name, f"{text!r:.80} is not a time; write 2026-11-22T10:00:00Z") from error
