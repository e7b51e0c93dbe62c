"""Cameras of the network: one probe of WS-Discovery, as the core specification of ONVIF has it, and who answers.

Anybody may answer, with anything. So an answer is bounded in size and number, document type declarations, which alone
can define entities, are refused before anything is parsed, and all that is taken from it is a name.
"""

from __future__ import annotations

import socket
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import unquote
from xml.etree import ElementTree as Xml

GROUP = ("239.255.255.250", 3702)
_SECONDS = 3.0
_MAX_ANSWER_BYTES = 16384
_MAX_ANSWERS = 512  # of all together; cameras repeat themselves
_MAX_CAMERAS = 64
_MAX_NAME = 64  # characters
_ADDRESSING = "http://schemas.xmlsoap.org/ws/2004/08/addressing"
_DISCOVERY = "http://schemas.xmlsoap.org/ws/2005/04/discovery"
_NAME_SCOPE = "onvif://www.onvif.org/name/"
_PROBE = f"""<?xml version="1.0" encoding="utf-8"?>
<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope" xmlns:a="{_ADDRESSING}" xmlns:d="{_DISCOVERY}">
<s:Header><a:MessageID>%s</a:MessageID><a:To>urn:schemas-xmlsoap-org:ws:2005:04:discovery</a:To>
<a:Action>{_DISCOVERY}/Probe</a:Action></s:Header><s:Body><d:Probe>
<d:Types xmlns:n="http://www.onvif.org/ver10/network/wsdl">n:NetworkVideoTransmitter</d:Types>
</d:Probe></s:Body></s:Envelope>"""


@dataclass(frozen=True, slots=True)
class NetworkCamera:
    """A device that says it is a camera: the address from which it answered, and the name it gives itself, or none."""

    address: str
    name: str


def find_network_cameras(
    group: tuple[str, int] = GROUP, seconds: float = _SECONDS, most: int = _MAX_CAMERAS
) -> tuple[NetworkCamera, ...]:
    """The cameras that answer within `seconds`, in the order of their addresses; none where there is no network.

    Args:
        group: address and port to which the probe goes.
        most: devices at most.
    """
    question = f"urn:uuid:{uuid.uuid4()}"
    found: dict[str, NetworkCamera] = {}
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            udp.sendto((_PROBE % question).encode(), group)
            for data, address in _answers(udp, seconds):
                name = name_in(data, question)
                if name is not None and (address in found or len(found) < most):
                    found[address] = NetworkCamera(address, name)
    except OSError:  # no way to the group
        return ()
    return tuple(sorted(found.values(), key=lambda each: socket.inet_aton(each.address)))


def _answers(udp: socket.socket, seconds: float) -> Iterator[tuple[bytes, str]]:
    end = time.monotonic() + seconds
    for _ in range(_MAX_ANSWERS):
        left = end - time.monotonic()
        if left <= 0:
            return
        udp.settimeout(left)
        try:
            data, (address, _) = udp.recvfrom(_MAX_ANSWER_BYTES + 1)
        except TimeoutError:
            return
        if len(data) <= _MAX_ANSWER_BYTES:
            yield data, address


def name_in(data: bytes, question: str) -> str | None:
    """The name in a camera's answer, empty where it gives none; None for what is no answer to `question`."""
    try:
        text = data.decode()
        if "<!" in text:  # a document type declaration, or a comment, which no answer needs
            return None
        envelope = Xml.fromstring(text)
    except (ValueError, Xml.ParseError):
        return None
    if (envelope.findtext(f".//{{{_ADDRESSING}}}RelatesTo") or "").strip() != question:
        return None
    match = envelope.find(f".//{{{_DISCOVERY}}}ProbeMatch")
    if match is None:
        return None
    scopes = (match.findtext(f"{{{_DISCOVERY}}}Scopes") or "").split()
    names = (unquote(scope[len(_NAME_SCOPE) :]) for scope in scopes if scope.startswith(_NAME_SCOPE))
    return "".join(each if each.isprintable() else " " for each in next(names, ""))[:_MAX_NAME].strip()
