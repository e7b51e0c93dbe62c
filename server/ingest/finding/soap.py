"""Questions to a network camera by SOAP over HTTP, as the core specification of ONVIF has them.

Whoever answers may be hostile. So an answer is bounded in size, document type declarations, which alone can define
entities, are refused before anything is parsed, and no redirection is followed. Who asks many devices, which may send a
byte every few seconds, sets itself an end.
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import secrets
import ssl
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from urllib.parse import urlsplit
from xml.etree import ElementTree as Xml
from xml.sax.saxutils import escape

from streamlod.core.errors import InputError

_SECONDS = 4.0  # without a byte
_MAX_ANSWER_BYTES = 262_144
_ENVELOPE = "http://www.w3.org/2003/05/soap-envelope"
_SECURITY = "http://docs.oasis-open.org/wss/2004/01/oasis-200401-wss"
_QUESTION = f"""<?xml version="1.0" encoding="utf-8"?>
<s:Envelope xmlns:s="{_ENVELOPE}"><s:Header>%s</s:Header><s:Body>%s</s:Body></s:Envelope>"""
_TOKEN = f"""<w:Security xmlns:w="{_SECURITY}-wssecurity-secext-1.0.xsd" s:mustUnderstand="1"><w:UsernameToken>
<w:Username>%s</w:Username>
<w:Password Type="{_SECURITY}-username-token-profile-1.0#PasswordDigest">%s</w:Password>
<w:Nonce EncodingType="{_SECURITY}-soap-message-security-1.0#Base64Binary">%s</w:Nonce>
<u:Created xmlns:u="{_SECURITY}-wssecurity-utility-1.0.xsd">%s</u:Created></w:UsernameToken></w:Security>"""


@dataclass(frozen=True, slots=True)
class Login:
    """A user of network cameras, with its password."""

    user: str
    password: str = field(repr=False)

    def header(self, ahead: timedelta) -> str:
        """A user name token with a digest (OASIS WSS 1.0), for a camera whose clock is so far ahead of ours."""
        nonce, created = secrets.token_bytes(16), f"{datetime.now(UTC) + ahead:%Y-%m-%dT%H:%M:%SZ}"
        text = nonce + (created + self.password).encode()
        digest = hashlib.sha1(text, usedforsecurity=False).digest()  # which the standard wants
        return _TOKEN % (escape(self.user), _base64(digest), _base64(nonce), created)


def envelope_in(data: bytes) -> Xml.Element | None:
    """The XML of an answer; None for what is none, or no safe one."""
    try:
        text = data.decode()
        if "<!" in text:  # a document type declaration, or a comment, which no answer needs
            return None
        return Xml.fromstring(text)
    except (ValueError, Xml.ParseError):
        return None


def is_service_of(device: str, address: str) -> bool:
    """Whether an HTTP address is one of the device itself, by its IP address: it must lead nobody elsewhere."""
    try:
        parts = urlsplit(address)
        return parts.scheme in ("http", "https") and parts.hostname == device and parts.port != 0
    except ValueError:
        return False


def ask(service: str, question: str, login: Login | None = None, ahead: timedelta = timedelta()) -> Xml.Element:
    """The answer of a camera's service.

    Args:
        service: its HTTP address.
        question: XML.
        login: where it wants one. ahead: see `Login.header`.

    Raises:
        InputError: there is no answer, or one that cannot be used.
    """
    place = urlsplit(service).hostname or service
    body = _QUESTION % ("" if login is None else login.header(ahead), question)
    status, data = _post(place, service, body.encode())
    answer = envelope_in(data) if len(data) <= _MAX_ANSWER_BYTES else None
    if status in (401, 403) or (answer is not None and "NotAuthorized" in _fault(answer)):
        wants = "wants a user and a password" if login is None else f"refuses the user {login.user}, or the password"
        raise InputError(place, f"{wants}; give --login USER:PASSWORD")
    if answer is None or status != 200 or _fault(answer):
        raise InputError(place, f"gave no answer to use (HTTP {status})")
    return answer


def _post(place: str, service: str, body: bytes) -> tuple[int, bytes]:
    """Status and body of an answer, a byte more than is allowed at most."""
    parts = urlsplit(service)
    if parts.scheme == "https":
        # Cameras have certificates of their own making. Nothing is sent that others must not read: a password goes as
        # a digest.
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            place, parts.port, timeout=_SECONDS, context=context
        )
    else:
        connection = http.client.HTTPConnection(place, parts.port, timeout=_SECONDS)
    try:
        path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        connection.request("POST", path, body, {"Content-Type": "application/soap+xml; charset=utf-8"})
        answer = connection.getresponse()
        return answer.status, answer.read(_MAX_ANSWER_BYTES + 1)
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise InputError(place, "does not answer by HTTP as cameras do") from error
    finally:
        connection.close()


def _fault(answer: Xml.Element) -> str:
    """The codes of a fault in an answer; empty where there is none."""
    fault = answer.find(f".//{{{_ENVELOPE}}}Fault")
    if fault is None:
        return ""
    return " ".join(["Fault", *(code.text or "" for code in fault.iter(f"{{{_ENVELOPE}}}Value"))])


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
