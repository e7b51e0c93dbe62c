"""The command `streamlod remote`: what `ServerClient` can do, from a terminal; returns the text to print."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from client.commands import TOKEN_VARIABLE
from client.rest import ServerClient
from core.errors import InputError

ALONE = ("list", "recordings", "server", "events")  # actions that need no stream
ACTIONS = (*ALONE, "show", "create", "change", "start", "stop", "delete", "viewers", "disconnect", "download")


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
        options: fields of the stream to create or change; ``viewer`` to disconnect; ``from``, ``to``, ``epoch`` of a
            download or a list of recordings.
        out: the file of a download.
        ca: certificates to trust.
    """
    if action not in ACTIONS:
        raise InputError("remote", f"{action} is none of {', '.join(ACTIONS)}")
    if name is None and action not in ALONE:
        raise InputError("remote", f"name the stream to {action}")
    with ServerClient(address, os.environ.get(TOKEN_VARIABLE), ca) as server:
        yield from _lines(server, action, name or "", dict(options or {}), out)


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
        server.delete(name, erase=bool(options.get("erase", False)))
    elif action == "disconnect":
        server.disconnect(name, str(options.get("viewer", "")))
    else:
        path = out or Path(f"{name}.slod")
        size = server.download(name, path, begin, end, options.get("epoch"))
        yield f"{path}: {size / 1000:.1f} KB"


def _time(options: dict[str, Any], name: str) -> datetime | None:
    text = options.get(name)
    try:
        return None if text is None else datetime.fromisoformat(str(text))
    except ValueError as error:
        raise InputError(name, f"{text!r:.80} is not a time; write 2026-11-22T10:00:00Z") from error
