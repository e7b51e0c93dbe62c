"""Passwords in the addresses of cameras: unreadable where a definition is stored, left out where it is shown.

Cameras have many names for a password. So all that an address says besides its place counts as one, unless it is known
to be harmless.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.core.files import put_in_place, temporary_beside
from streamlod.server.stream.stored_stream import PRIVATE_FILE

_URL = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
_USER = re.compile(r"[\w.-]{1,64}")
_PLAIN = re.compile(r"[\w.,:x-]{0,32}(?=\s|['\")]|$)")
_HARMLESS = {  # options of addresses that hold no password, as FFmpeg and common cameras name them
    "action", "buffer_size", "camera", "cameraid", "channel", "codec", "compression", "fifo_size", "fps",
    "framerate", "height", "latency", "listen", "mode", "pbkeylen", "pkt_size", "profile", "quality",
    "resolution", "rotation", "size", "stream", "subtype", "timeout", "track", "trackid", "transport",
    "transportmode", "unicast", "videocodec", "width",
}  # fmt: skip
_SEALED = "sealed"


def masked(value: Any) -> Any:
    """A JSON value with stars for all passwords in it."""
    return _changed(value, _mask)


def _mask(text: str) -> str:
    """Stars for user parts and for options that are not known to be harmless, in all addresses in a text."""
    begins = [found.start() for found in _URL.finditer(text)]
    parts = [text[begin:end] for begin, end in itertools.pairwise([*begins, len(text)])]
    return text[: begins[0]] + "".join(map(_mask_address, parts)) if begins else text


def _mask_address(text: str) -> str:
    """An address, and what follows it in a sentence.

    A password may hold any character, `/?#@` and blanks too: whatever stands before the last `@` belongs to the user.
    """
    scheme, _, rest = text.partition("://")
    user, at, rest = rest.rpartition("@")
    if at:
        name, colon, _ = user.partition(":")
        user = f"{name}:***" if colon and _USER.fullmatch(name) else "***"
    path = re.search(r"[/?#]", rest)
    begin = path.start() if path else len(rest)
    options = re.split(r"([?&;#])" if "?" in rest or "#" in rest else r"([/?&;#])", rest[begin:])
    is_query, masked_options = False, ""
    for option in options:
        masked_options += _mask_option(option, bare=is_query)
        is_query = is_query or option in ("?", "#")
    return f"{scheme}://{user}{at}{rest[:begin]}{masked_options}"


def _mask_option(option: str, *, bare: bool) -> str:
    """`name=value` with stars for the value; with `bare` also what has no name, as it may be a token."""
    name, equals, value = option.partition("=")
    if not equals and (not bare or option in ("", "?", "&", ";", "#") or option.lower() in _HARMLESS):
        return option
    if not equals:
        return "***"
    if name.rpartition("/")[2].lower() in _HARMLESS and _PLAIN.match(value):
        return option
    return f"{name}=***"


class Seal:
    """Encrypts what must not be readable in a copy of the state folder's other files.

    Args:
        path: file of the key, which is made if it is missing.

    Raises:
        InputError: it cannot be made or read.
    """

    def __init__(self, path: Path) -> None:
        from cryptography.fernet import Fernet

        try:
            if not path.exists() or path.stat().st_size == 0:  # an earlier version left that on a full disk
                _write_key(path, Fernet.generate_key())
            self._cipher = Fernet(path.read_bytes().strip())
        except (OSError, ValueError) as error:
            raise InputError(path, f"is no key that passwords can be stored with ({error})") from error

    def close(self, value: Any) -> Any:
        """The JSON value with every text that holds a password replaced."""

        def seal(text: str) -> Any:
            return text if _mask(text) == text else {_SEALED: self._cipher.encrypt(text.encode()).decode()}

        return _changed(value, seal)

    def open(self, value: Any) -> Any:
        """The value that `close` was given.

        Raises:
            InputError: it was closed with another key.
        """
        from cryptography.fernet import InvalidToken

        if isinstance(value, dict):
            if set(value) != {_SEALED}:
                return {name: self.open(item) for name, item in value.items()}
            try:
                return self._cipher.decrypt(str(value[_SEALED]).encode()).decode()
            except InvalidToken as error:
                raise InputError("a stored password", "was stored with another key; create the stream again") from error
        return [self.open(item) for item in value] if isinstance(value, list) else value


def _write_key(path: Path, key: bytes) -> None:
    """Write a key file for its owner alone, whole or not at all."""
    new = temporary_beside(path)
    try:
        with os.fdopen(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE_FILE), "wb") as file:
            file.write(key)
        put_in_place(new, path)
    finally:
        new.unlink(missing_ok=True)


def _changed(value: Any, change: Callable[[str], Any]) -> Any:
    if isinstance(value, dict):
        return {name: _changed(item, change) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_changed(item, change) for item in value]
    return change(value) if isinstance(value, str) else value
