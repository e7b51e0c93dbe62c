"""Access rights: static tokens, stored hashed, and JSON web tokens. Refusals are slow and counted."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import logging
import re
import time
from collections import OrderedDict, deque
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.server.auth.keys import TokenKeys, is_address
from streamlod.server.auth.links import LinkSigner
from streamlod.server.settings import Settings

_LOG = logging.getLogger(__name__)
_MAX_ADDRESSES = 10_000
_MAX_TOKEN_CHARACTERS = 4096
_MINUTE = 60.0
_WEB_TOKEN = re.compile(r"[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+")
_LOOK_SECONDS = 1.0  # between two looks whether a file has changed
MAX_REVOKED = 100_000


class Right(StrEnum):
    """The rights of a token."""

    READ = "read"
    PUBLISH = "publish"
    CONTROL = "control"
    METRICS = "metrics"
    PRESENT = "present"


@dataclass(frozen=True, slots=True)
class Grant:
    """Rights on the streams whose id matches a pattern such as ``*`` or ``stage-*``.

    Attributes:
        rights: what may be done.
        streams: the pattern.
        expires: Unix time at which the token ends, or None for one that does not end by itself.
    """

    rights: frozenset[Right]
    streams: str = "*"
    expires: int | None = None

    def allows(self, right: Right, stream: str | None) -> bool:
        """Whether `right` is given, on `stream` if one is named."""
        return right in self.rights and (stream is None or fnmatchcase(stream, self.streams))

    @property
    def covers_all(self) -> bool:
        """Whether it is for every stream, and so for what belongs to none."""
        return self.streams == "*"


EVERYTHING = Grant(frozenset(Right))


def hash_token(token: str) -> str:
    """The SHA-256 that token files hold."""
    return hashlib.sha256(token.encode()).hexdigest()


class Gate:
    """Decides who may do what.

    Args:
        settings: name the files; `reload` reads them again.

    Attributes:
        links: signs addresses of downloads.
        refused: wrong tokens so far.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._grants: dict[str, Grant] = {}
        self._keys = TokenKeys(settings)
        self.links = LinkSigner(settings.link_key)
        self._refusals: OrderedDict[str, deque[float]] = OrderedDict()
        self._most_refusals = settings.limits.refusals_per_minute
        self.refused = 0
        self._revoked: frozenset[str] = frozenset()
        self._looked_at = 0.0
        self._marks: tuple[object, ...] = ()
        self.reload()

    @property
    def is_open(self) -> bool:
        """Whether nobody needs a token."""
        return not self._settings.has_tokens

    def reload(self) -> None:
        """Read the files of tokens, keys and revocations.

        Raises:
            InputError: a file cannot be used; the earlier tokens stay.
        """
        self._looked_at, self._marks = time.monotonic(), self._file_marks()
        grants = {} if self._settings.tokens is None else read_tokens(self._settings.tokens)
        revoked = frozenset() if self._settings.revoked is None else read_revoked(self._settings.revoked)
        self._keys.reload()
        self.links.reload()
        self._grants, self._revoked = grants, revoked

    def look(self) -> None:
        """Read the files again if one has changed; where they cannot be used, the earlier ones stay."""
        if time.monotonic() - self._looked_at < _LOOK_SECONDS:
            return
        self._looked_at = time.monotonic()
        if self._file_marks() != self._marks:
            try:
                self.reload()
                _LOG.info("tokens were read again")
            except InputError as error:
                _LOG.error("tokens were not read again, the earlier ones stay: %s", error)

    def _file_marks(self) -> tuple[object, ...]:
        """The state that changes with the files."""
        settings, marks = self._settings, []
        key_set = Path(settings.jwks) if settings.jwks is not None and not is_address(settings.jwks) else None
        for path in (settings.tokens, settings.revoked, settings.jwt_key, settings.link_key, key_set):
            try:
                found = path.stat() if path is not None else None
                marks.append(found and (found.st_mtime_ns, found.st_size, found.st_ino))
            except OSError:
                marks.append(None)
        return tuple(marks)

    async def admit(self, token: str | None) -> Grant | None:
        """`grant_of`, after files that have changed were read and keys that the token needs were fetched."""
        self.look()
        if token and len(token) <= _MAX_TOKEN_CHARACTERS and token.count(".") == 2:
            await self._keys.refresh(token)
        return self.grant_of(token)

    def grant_of(self, token: str | None) -> Grant | None:
        """The rights of `token`, or None if it is not known."""
        if self.is_open:
            return EVERYTHING
        if not token or len(token) > _MAX_TOKEN_CHARACTERS:
            return None
        offered, found = hash_token(token), None
        for known, grant in self._grants.items():  # compare with all of them, so that the time taken tells nothing
            if hmac.compare_digest(known, offered):
                found = grant
        if found is None and _is_canonical(token) and offered not in self._revoked:
            claims = self._keys.claims(token)
            if claims is not None and str(claims.get("jti", "")) not in self._revoked:
                return _grant_of_claims(claims)
        return found

    def limit_refusals(self, per_minute: int) -> None:
        """Block an address after so many wrong tokens; those that were counted stay."""
        self._most_refusals = per_minute
        for address, times in self._refusals.items():
            self._refusals[address] = deque(times, maxlen=per_minute)

    def note_refusal(self, address: str) -> None:
        """Count a wrong token from `address`."""
        self.refused += 1
        times = self._refusals.setdefault(address, deque(maxlen=self._most_refusals))
        times.append(time.monotonic())
        self._refusals.move_to_end(address)
        while len(self._refusals) > _MAX_ADDRESSES:
            self._refusals.popitem(last=False)

    def is_blocked(self, address: str) -> bool:
        """Whether `address` has offered too many wrong tokens within the last minute."""
        times = self._refusals.get(address)
        return times is not None and len(times) == times.maxlen and time.monotonic() - times[0] < _MINUTE


def _is_canonical(token: str) -> bool:
    """Whether a JSON web token is spelled in the one way that base64url without padding has (RFC 7515 section 2).

    Decoders take others for the same token, of which a list of withdrawn ones would know nothing.
    """
    if not _WEB_TOKEN.fullmatch(token):
        return False
    for part in token.split("."):
        try:
            data = base64.urlsafe_b64decode(part + "=" * (-len(part) % 4))
        except ValueError:
            return False
        if base64.urlsafe_b64encode(data).rstrip(b"=").decode() != part:
            return False
    return True


def read_tokens(path: Path) -> dict[str, Grant]:
    """Grants by token hash, from ``[{"name", "sha256", "rights": [...], "streams": "*"}, ...]``.

    Raises:
        InputError: the file cannot be read, or is not of that form.
    """
    try:
        entries = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read as JSON ({error})") from error
    if not isinstance(entries, list):
        raise InputError(path, "must hold a list of tokens")
    return dict(_read_entry(path, number, entry) for number, entry in enumerate(entries))


def read_revoked(path: Path) -> frozenset[str]:
    """Identifiers (`jti`) or SHA-256 of JSON web tokens that count no more, a line each; `#` begins a comment.

    Raises:
        InputError: the file cannot be read, or has too many lines.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({error})") from error
    if len(lines) > MAX_REVOKED:
        raise InputError(path, f"has more than {MAX_REVOKED} lines; take out tokens that have expired")
    return frozenset(filter(None, (line.partition("#")[0].strip() for line in lines)))


def _read_entry(path: Path, number: int, entry: Any) -> tuple[str, Grant]:
    try:
        digest, grant = str(entry["sha256"]), _grant(entry)
        if len(bytes.fromhex(digest)) != hashlib.sha256().digest_size:
            raise ValueError("sha256 must have 64 hexadecimal digits")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(path, f"token {number} is not usable: {error}") from error
    return digest.lower(), grant


def _grant_of_claims(claims: dict[str, Any]) -> Grant | None:
    """The grant in claim ``lod``: {"rights": [...], "streams": "*"}; None where it holds none."""
    try:
        return _grant(claims["lod"], int(claims["exp"]))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None


def _grant(value: Any, expires: int | None = None) -> Grant:
    """The grant that a JSON object holds; TypeError where rights are no list, or streams no text, which could match."""
    rights, streams = value["rights"], value.get("streams", "*")
    if not isinstance(rights, list) or not isinstance(streams, str):
        raise TypeError("rights must be a list, and streams one pattern")
    return Grant(frozenset(Right(right) for right in rights), streams, expires)
