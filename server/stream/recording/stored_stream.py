"""The file that a state folder keeps of a stream beside its recordings: `streams/ID/stream.json`, for its owner alone.

It is the only copy of what the stream is made from.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from streamlod.core.errors import StorageError
from streamlod.core.files import put_in_place

_LOG = logging.getLogger(__name__)
STORED_NAME = "stream.json"
_MAX_BYTES = 4 << 20
PRIVATE_FILE, PRIVATE_FOLDER = 0o600, 0o700


@dataclass(frozen=True, slots=True)
class StoredStream:
    """A stream as it is remembered.

    Attributes:
        incarnation: names this stream's packets for good; a stream that is made anew under its id has another.
        epoch: highest that was ever used.
        definition: what it is made from, for one that was created over REST and not deleted since.
        running: whether it is to be started with the server.
        created_ns: Unix time of its creation.
        trained_from: tells what the highest epoch is trained from; empty where nothing of it is left to train.
        lead: version of that epoch which the source's first frame had or would have had; later frames follow it.
        others: fields of another version of the program, which are kept for it.
    """

    incarnation: str = field(default_factory=lambda: secrets.token_hex(8))
    epoch: int = 0
    definition: dict[str, Any] | None = None
    running: bool = False
    created_ns: int = 0
    trained_from: str = ""
    lead: int = 0
    others: dict[str, Any] = field(default_factory=dict)


_FIELDS = {each.name for each in fields(StoredStream)} - {"others"}


def read_stored(folder: Path) -> StoredStream | None:
    """The stream that `write_stored` wrote; None without a whole file, a damaged one is kept as `stream.damaged`."""
    path = folder / STORED_NAME
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError("it is too large")
        values = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(values, dict):
            raise ValueError("it is no JSON object")
        known = {name: value for name, value in values.items() if name in _FIELDS}
        others = {name: value for name, value in values.items() if name not in _FIELDS}
        if others:
            _LOG.info("%s has fields of another version, which are kept: %s", path, ", ".join(sorted(others)))
        stored = StoredStream(**known, others=others)
        kinds = {"incarnation": str, "epoch": int, "definition": dict | None, "running": bool, "created_ns": int,
                 "trained_from": str, "lead": int}  # fmt: skip
        if not all(isinstance(getattr(stored, name), kind) for name, kind in kinds.items()):
            raise ValueError("a value is of the wrong type")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        _LOG.warning("%s cannot be used (%s); it is kept as stream.damaged, and its stream begins anew", path, error)
        with suppress(OSError):
            path.replace(path.with_suffix(".damaged"))
        return None
    return stored


def write_stored(folder: Path, stored: StoredStream) -> None:
    """Replace what is stored, at once or not at all, in a folder that is made if it is missing.

    Raises:
        StorageError: the disk is full, or the folder cannot be written; nothing has changed.
    """
    path = folder / STORED_NAME
    new = path.with_suffix(".new")
    try:
        folder.mkdir(exist_ok=True, mode=PRIVATE_FOLDER)
        with os.fdopen(os.open(new, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, PRIVATE_FILE), "w") as file:
            values = asdict(stored)
            json.dump(values.pop("others") | values, file)
        put_in_place(new, path)
    except OSError as error:
        with suppress(OSError):
            new.unlink(missing_ok=True)
        raise StorageError(path, f"cannot be written ({error.strerror})") from error
