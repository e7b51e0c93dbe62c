"""The keys for checking JSON web tokens: from a file, and from a key set (RFC 7517) in a file or at an address.

The key decides the algorithm, never the token: a token's header is used only to find its key.

PyJWT's own client of key sets is not used, because it asks again for every token while the key server fails, has all
tokens wait for that, and reads an answer of any length. With 20 tokens of unknown keys and a key server that answers
503 after 0.5 s, it asked 21 times, and a token of a known key waited up to 10.8 s; this module asked once, 0.5 s
(`python -m tests.bench.key_set_bench`, 22 November 2026).

PyJWT and httpx are imported where they are used: PyJWT takes 9 MB with the cryptography beneath it, which a server
without JSON web tokens spares.
"""

from __future__ import annotations

import asyncio
import json
import logging
import ssl
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from streamlod.core.errors import InputError
from streamlod.server.settings import Settings

_LOG = logging.getLogger(__name__)
_AUDIENCE = "streamlod"
_LEEWAY_SECONDS = 30
_MAX_SET_BYTES = 65536  # bytes
_MAX_KEYS = 32
_FETCH_SECONDS = 5.0  # for all of an answer: a token of an unknown key waits as long
_ASKED = {"Accept": "application/json", "Accept-Encoding": "identity"}
_FRESH_SECONDS = 600.0  # a set is fetched again after that
_PAUSE_SECONDS = 30.0  # between two attempts, however many tokens ask for unknown keys
_MIN_SECRET_CHARACTERS = 32
_MIN_RSA_BITS = 2048
_ALGORITHMS: dict[tuple[Any, Any], str] = {
    ("OKP", "Ed25519"): "EdDSA",
    ("EC", "P-256"): "ES256",
    ("RSA", None): "RS256",
    ("oct", None): "HS256",
}


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """One key, its id if it has one, and the only algorithm that it is used for."""

    id: str | None
    algorithm: str
    value: Any


class TokenKeys:
    """All keys of the settings.

    Args:
        settings: name the files and the address; `reload` reads the files again.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._own: tuple[Key, ...] = ()  # of files
        self._fetched: tuple[Key, ...] = ()
        self._fetched_at = self._tried_at = -float("inf")
        self._fetching = asyncio.Lock()

    def reload(self) -> None:
        """Read the files, and forget when the set was fetched.

        Raises:
            InputError: a file or the address cannot be used; the earlier keys stay.
        """
        own: list[Key] = []
        if self._settings.jwt_key is not None:
            own.append(_key_of_file(self._settings.jwt_key))
        place = self._settings.jwks
        if place is not None and is_address(place):
            check_address(place)
        elif place is not None:
            own += parse_keys(place, _read(Path(place)))
        self._own = tuple(own)
        self._fetched_at = self._tried_at = -float("inf")

    async def refresh(self, token: str) -> None:
        """Fetch the set from its address where it is too old, or lacks the key that `token` claims."""
        address = self._settings.jwks
        if address is None or not is_address(address) or (claimed := _claimed_id(token)) is None:
            return
        if self._holds(claimed):  # a token with a known key does not wait for a fetch
            return
        async with self._fetching:
            now = time.monotonic()
            if now - self._tried_at < _PAUSE_SECONDS or self._holds(claimed):
                return
            self._tried_at = now
            try:
                self._fetched = parse_keys(address, await _fetch(address))
                self._fetched_at = now
            except (InputError, OSError, ValueError) as error:
                _LOG.warning("key set %s: not fetched, the earlier keys stay: %s", address, error)

    def _holds(self, claimed: str) -> bool:
        """Whether a key of that id was fetched recently."""
        fresh = time.monotonic() - self._fetched_at < _FRESH_SECONDS
        return fresh and any(key.id == claimed for key in self._fetched)

    def claims(self, token: str) -> dict[str, Any] | None:
        """The claims of a token that a key here has signed and that is valid now, or None."""
        keys = (*self._own, *self._fetched)
        if not keys:
            return None
        import jwt

        claimed = _claimed_id(token)
        for key in keys:
            if key.id is not None and key.id != claimed:
                continue
            try:
                claims: dict[str, Any] = jwt.decode(
                    token, key.value, algorithms=[key.algorithm], leeway=_LEEWAY_SECONDS, audience=_AUDIENCE,
                    options={"require": ["exp", "aud"]},
                )  # fmt: skip
            except (jwt.PyJWTError, ValueError, TypeError):
                continue
            return claims
        return None


def is_address(place: str) -> bool:
    """Whether a setting names an address rather than a file."""
    return place.startswith(("https://", "http://"))


def check_address(address: str) -> None:
    """Refuse a key set that others on the way could replace.

    Raises:
        InputError: neither https nor on this machine.
    """
    parts = urlsplit(address)
    if parts.scheme != "https" and parts.hostname not in {"127.0.0.1", "localhost", "::1"}:
        raise InputError("jwks", f"{address!r:.200} must be an https address, or a file")


def parse_keys(subject: object, text: bytes) -> tuple[Key, ...]:
    """The usable keys of a JSON web key set; those of other kinds or uses are left out.

    Raises:
        InputError: it is no key set, too large, or has no key that can be used.
    """
    try:
        if len(text) > _MAX_SET_BYTES:
            raise ValueError(f"more than {_MAX_SET_BYTES} bytes")
        entries = json.loads(text)["keys"]
        if not isinstance(entries, list) or len(entries) > _MAX_KEYS:
            raise ValueError(f"keys must be a list of at most {_MAX_KEYS}")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(subject, f"is not a JSON web key set ({error})") from error
    keys = tuple(key for entry in entries if (key := _parse_key(entry)) is not None)
    if not keys:
        raise InputError(subject, "has no Ed25519, P-256, RSA or secret key that tokens can be checked with")
    return keys


def _parse_key(entry: Any) -> Key | None:
    if not isinstance(entry, dict) or entry.get("use", "sig") != "sig":
        return None
    kind, curve, name = entry.get("kty"), entry.get("crv"), entry.get("kid")
    if not all(isinstance(field, str | None) for field in (kind, curve, name)):
        return None
    algorithm = _ALGORITHMS.get((kind, curve))
    if algorithm is None or entry.get("alg", algorithm) != algorithm:
        return None
    import jwt

    try:
        value = jwt.PyJWK(entry, algorithm).key
    except (jwt.PyJWTError, ValueError, TypeError, KeyError, AttributeError):
        return None
    weak = (algorithm == "HS256" and len(value) < _MIN_SECRET_CHARACTERS) or (
        algorithm == "RS256" and value.key_size < _MIN_RSA_BITS
    )
    return None if weak else Key(name, algorithm, value)


def _key_of_file(path: Path) -> Key:
    """A PEM public key, or else a secret."""
    try:
        text = _read(path).decode("utf-8-sig").strip()
    except UnicodeDecodeError as error:
        raise InputError(path, f"cannot be read ({error})") from error
    if len(text) < _MIN_SECRET_CHARACTERS:
        raise InputError(path, f"a key needs at least {_MIN_SECRET_CHARACTERS} characters")
    if not text.startswith("-----BEGIN"):
        return Key(None, "HS256", text)
    import jwt

    try:
        return Key(None, "EdDSA", jwt.get_algorithm_by_name("EdDSA").prepare_key(text))
    except (jwt.PyJWTError, ValueError, TypeError) as error:
        raise InputError(path, f"is not an Ed25519 key ({error})") from error


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_MAX_SET_BYTES + 1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error})") from error


def _claimed_id(token: str) -> str | None:
    """The key id of a token's header, "" if it names none; None if this is no JSON web token."""
    import jwt

    try:
        name = jwt.get_unverified_header(token).get("kid", "")
    except (jwt.PyJWTError, ValueError, TypeError, RecursionError):
        return None
    return name if isinstance(name, str) else None


async def _fetch(address: str) -> bytes:
    """The answer of a key server.

    No redirection is followed, which could lead to an address without TLS.

    Raises:
        OSError: it refuses; its answer breaks off, is no HTTP or is too long; or all of it takes more than
            `_FETCH_SECONDS`.
    """
    import httpx

    body = bytearray()
    try:
        async with (
            asyncio.timeout(_FETCH_SECONDS),
            httpx.AsyncClient(verify=ssl.create_default_context(), timeout=None) as client,  # the system's certificates
            client.stream("GET", address, headers=_ASKED) as answer,
        ):
            if not answer.is_success:
                raise OSError(f"it answers {answer.status_code}")
            async for chunk in answer.aiter_raw():
                body += chunk
                if len(body) > _MAX_SET_BYTES:
                    raise OSError(f"it answers with more than {_MAX_SET_BYTES} bytes")
    except TimeoutError as error:
        raise OSError(f"it takes more than {_FETCH_SECONDS:g} s") from error
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise OSError(str(error) or type(error).__name__) from error
    return bytes(body)
