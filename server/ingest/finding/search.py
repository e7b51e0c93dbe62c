"""Looks for cameras of this machine and of the network, and names them for a rig."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from streamlod.server.ingest.cameras.address import Address, parse_address
from streamlod.server.ingest.finding.onvif import GROUP, SECONDS, find_network_cameras
from streamlod.server.ingest.finding.soap import Login
from streamlod.server.ingest.finding.streams import find_streams
from streamlod.server.ingest.finding.webcams import find_webcams

_MAX_NAME = 56  # characters of a name before its number
_MANUAL = "give addresses that are not found yourself: rtsp://USER:PASSWORD@ADDRESS/... as the cameras' manuals say"


@dataclass(frozen=True, slots=True)
class NamedSource:
    """A camera of a rig to be written: its name, and its source as docs/ingest.md writes it."""

    name: str
    source: str = field(repr=False)

    @property
    def address(self) -> Address:
        """Where its pictures come from."""
        return parse_address(self.source)


def search(
    say: Callable[[str], object],
    login: Login | None = None,
    group: tuple[str, int] = GROUP,
    seconds: float = SECONDS,
) -> list[NamedSource]:
    """Webcams of this machine, then the streams of network cameras, by their own names where these are fit for it.

    Args:
        say: told what was found.
        login: of network cameras that want one.
        group, seconds: see `find_network_cameras`.
    """
    say(f"looking for cameras of this machine and, for {seconds:g} seconds, of the network")
    found = []
    for webcam in find_webcams():
        found.append(NamedSource(f"webcam{webcam.number}", webcam.source))
        say(f"{found[-1].name}: {webcam.name or 'without a name'}")
    offers = find_streams(find_network_cameras(group, seconds), login)
    for offer in offers:
        device = f"{offer.camera.name or 'without a name'} at {offer.camera.address} (ONVIF)"
        if offer.fault:
            say(f"{device} {offer.fault}")
        for address in offer.addresses:
            found.append(NamedSource(_name(offer.camera.name, [each.name for each in found]), address))
            say(f"{found[-1].name}: {device}")
    if any(offer.fault for offer in offers):
        say(_MANUAL)
    return found


def _name(called: str, taken: Collection[str]) -> str:
    """A camera's name in a rig, after what a device calls itself."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", called).strip("-_.")[:_MAX_NAME] or "network"
    names = [plain, *(f"{plain}-{number}" for number in range(2, len(taken) + 3))]
    return next(name for name in names if name not in taken)
