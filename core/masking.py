"""Passwords in addresses, left out where these are shown.

Cameras have many names for a password. So all that an address says besides its place counts as one, unless it is known
to be harmless.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from typing import Any

_URL = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
_USER = re.compile(r"[\w.-]{1,64}")
_PLAIN = re.compile(r"[\w.,:x-]{0,32}(?=\s|['\")]|$)")
_HARMLESS = {  # options of addresses that hold no password, as FFmpeg and common cameras name them
    "action", "buffer_size", "camera", "cameraid", "channel", "codec", "compression", "fifo_size", "fps",
    "framerate", "height", "latency", "listen", "mode", "pbkeylen", "pkt_size", "profile", "quality",
    "resolution", "rotation", "size", "stream", "subtype", "timeout", "track", "trackid", "transport",
    "transportmode", "unicast", "videocodec", "width",
}  # fmt: skip


def masked(value: Any) -> Any:
    """A JSON value with stars for all passwords in it."""
    return with_texts(value, mask_text)


def mask_text(text: str) -> str:
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


def with_texts(value: Any, change: Callable[[str], Any]) -> Any:
    """A JSON value with every text in it changed."""
    if isinstance(value, dict):
        return {name: with_texts(item, change) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [with_texts(item, change) for item in value]
    return change(value) if isinstance(value, str) else value
