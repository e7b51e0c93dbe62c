"""Passwords in the addresses of cameras (`core.masking`), unreadable where a definition is stored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.core.files import write_bytes
from streamlod.core.masking import mask_text, with_texts

_SEALED = "sealed"


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
                write_bytes(path, Fernet.generate_key(), private=True)
            self._cipher = Fernet(path.read_bytes().strip())
        except (OSError, ValueError) as error:
            raise InputError(path, f"is no key that passwords can be stored with ({error})") from error

    def close(self, value: Any) -> Any:
        """The JSON value with every text that holds a password replaced."""

        def seal(text: str) -> Any:
            return text if mask_text(text) == text else {_SEALED: self._cipher.encrypt(text.encode()).decode()}

        return with_texts(value, seal)

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
