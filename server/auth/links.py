"""Signed links: whoever has one may download that path, and nothing else, until it expires.

The signature covers the path, or a folder above it, the time, and the stream's incarnation, so that it opens no other
stream that is made under the same id later.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import time
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlencode

from streamlod.server.auth.secret_file import read_secret

MAX_LINK_SECONDS = 7 * 24 * 3600
_DIGITS = re.compile(r"[0-9]{1,12}")


class LinkSigner:
    """Signs and checks.

    Args:
        path: file with a secret; without one links end with the process.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._key = secrets.token_bytes(32)

    def reload(self) -> None:
        """Read the secret again.

        Raises:
            InputError: the file cannot be used; the earlier secret stays.
        """
        if self._path is not None:
            self._key = read_secret(self._path)

    def sign(self, scope: str, expires: int, incarnation: str) -> str:
        """The query that opens `scope`, a path or one ending in ``/`` for all below, until Unix time `expires`.

        Without an incarnation it opens whichever stream has that name, also of a later server with the same secret.
        """
        signature = self._signature(scope, str(expires), incarnation)
        fields = {"expires": str(expires), "incarnation": incarnation, "signature": signature}
        return urlencode({**fields, "scope": scope} if scope.endswith("/") else fields)

    def allows(self, path: str, query: Mapping[str, str], incarnation: str) -> bool:
        """Whether `query` holds a signature that covers `path` now, of a stream of that incarnation."""
        expires = query.get("expires", "")
        now_valid = _DIGITS.fullmatch(expires) is not None and time.time() < int(expires)
        return self._is_genuine(path, query, "" if query.get("incarnation") == "" else incarnation) and now_valid

    def has_ended(self, path: str, query: Mapping[str, str]) -> bool:
        """Whether `query` once opened `path`, and nobody guessed it: it has expired, or its stream was replaced."""
        return self._is_genuine(path, query, query.get("incarnation", ""))

    def _is_genuine(self, path: str, query: Mapping[str, str], incarnation: str) -> bool:
        scope = query.get("scope", path)
        covered = scope == path or (scope.endswith("/") and path.startswith(scope))
        expected = self._signature(scope, query.get("expires", ""), incarnation)
        return covered and hmac.compare_digest(expected.encode(), query.get("signature", "").encode())

    def _signature(self, scope: str, expires: str, incarnation: str) -> str:
        return hmac.new(self._key, f"{expires}\n{incarnation}\n{scope}".encode(), hashlib.sha256).hexdigest()
