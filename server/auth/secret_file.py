"""Reads secrets that sign: of download links and of webhooks."""

from __future__ import annotations

from codecs import BOM_UTF8
from pathlib import Path

from streamlod.core.errors import InputError

_MIN_CHARACTERS = 32


def read_secret(path: Path) -> bytes:
    """The secret in a file, without what an editor puts around it: white space, a byte order mark.

    Raises:
        InputError: it cannot be read, or is too short.
    """
    try:
        key = path.read_bytes().removeprefix(BOM_UTF8).strip()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error})") from error
    if len(key) < _MIN_CHARACTERS:
        raise InputError(path, f"a key needs at least {_MIN_CHARACTERS} characters")
    return key
