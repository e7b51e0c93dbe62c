"""Cameras of the network: one probe of WS-Discovery, as the core specification of ONVIF has it, and who answers.

Anybody may answer, with anything. So an answer is bounded in size and number, document type declarations, which alone
can define entities, are refused before anything is parsed, and all that is taken from it is a name, and where the same
device tells more.
"""

from __future__ import annotations

import socket
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import unquote

from streamlod.server.ingest.finding.soap import envelope_in, is_service_of

GROUP = ("239.255.255.250", 3702)
SECONDS = 3.0
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
    """A device that says it is a camera.

    Attributes:
        address: from which it answered.
        name: that it gives itself; empty where it gives none.
        service: its HTTP address at which it tells more; None where it names none of its own.
    """

    address: str
    name: str
    service: str | None = None


def find_network_cameras(group: tuple[str, int], seconds: float, most: int = _MAX_CAMERAS) -> tuple[NetworkCamera, ...]:
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
                camera = camera_in(data, question, address)
                if camera is not None and (address in found or len(found) < most):
                    found[address] = camera
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


def camera_in(data: bytes, question: str, address: str) -> NetworkCamera | None:
    """The camera that sent an answer from an address; None for what is no answer to `question`."""
    envelope = envelope_in(data)
    if envelope is None or (envelope.findtext(f".//{{{_ADDRESSING}}}RelatesTo") or "").strip() != question:
        return None
    match = envelope.find(f".//{{{_DISCOVERY}}}ProbeMatch")
    if match is None:
        return None
    scopes = (match.findtext(f"{{{_DISCOVERY}}}Scopes") or "").split()
    names = (unquote(scope[len(_NAME_SCOPE) :]) for scope in scopes if scope.startswith(_NAME_SCOPE))
    name = "".join(each if each.isprintable() else " " for each in next(names, ""))[:_MAX_NAME].strip()
    services = (match.findtext(f"{{{_DISCOVERY}}}XAddrs") or "").split()
    return NetworkCamera(address, name, next((each for each in services if is_service_of(address, each)), None))
