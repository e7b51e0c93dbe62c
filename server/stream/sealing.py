"""Passwords in the addresses of cameras: unreadable where a definition is stored, left out where it is shown."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.server.stream.stored_stream import PRIVATE_FILE

_CREDENTIALS = re.compile(r"(?P<scheme>[a-z0-9+]+://)(?P<user>[^/?#\s:@]*):(?P<password>[^/?#\s]*)@", re.IGNORECASE)
_SECRET_FIELDS = re.compile(r"(?P<name>(passphrase|password|token|key|secret)=)[^&\s]+", re.IGNORECASE)
_SEALED = "sealed"


def masked(value: Any) -> Any:
    """A JSON value with stars for all passwords in it."""
    return _changed(value, _mask)


def _mask(text: str) -> str:
    text = _CREDENTIALS.sub(lambda found: f"{found['scheme']}{found['user']}:***@", text)
    return _SECRET_FIELDS.sub(lambda found: f"{found['name']}***", text) if "://" in text else text


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
            if not path.exists():
                with os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE_FILE), "wb") as file:
                    file.write(Fernet.generate_key())
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


def _changed(value: Any, change: Callable[[str], Any]) -> Any:
    if isinstance(value, dict):
        return {name: _changed(item, change) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_changed(item, change) for item in value]
    return change(value) if isinstance(value, str) else value
