"""Addresses of the web as people write them."""

from __future__ import annotations

from urllib.parse import SplitResult, urlsplit

from streamlod.core.errors import InputError


def address_parts(subject: str, url: str) -> SplitResult:
    """The parts of an address, of which host and port can be used.

    Args:
        subject: what an error is about.

    Raises:
        InputError: they cannot.
    """
    try:
        parts = urlsplit(url)
        _ = parts.port, (parts.hostname or "").encode("idna")  # either raises what would be raised on the way there
    except ValueError as error:
        raise InputError(subject, f"{url!r:.200} is no address ({error}); it looks like https://HOST:PORT") from error
    return parts
