"""The addresses of the streams that network cameras offer, as the media service of ONVIF tells them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from urllib.parse import quote, urlsplit, urlunsplit
from xml.etree import ElementTree as Xml
from xml.sax.saxutils import escape

from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.finding.at_once import at_once
from streamlod.server.ingest.finding.onvif import NetworkCamera
from streamlod.server.ingest.finding.soap import Login, ask, is_service_of

_ALL_SECONDS = 15.0  # for all cameras together
_MAX_PROFILES = 64  # of a camera
_MAX_TOKEN = 64  # characters, as ONVIF has it
_MAX_SIDE = 16384  # pixels
_DEVICE = "http://www.onvif.org/ver10/device/wsdl"
_MEDIA = "http://www.onvif.org/ver10/media/wsdl"
_TYPES = "{http://www.onvif.org/ver10/schema}"
_CLOCK = f'<GetSystemDateAndTime xmlns="{_DEVICE}"/>'
_CAPABILITIES = f'<GetCapabilities xmlns="{_DEVICE}"><Category>Media</Category></GetCapabilities>'
_PROFILES = f'<GetProfiles xmlns="{_MEDIA}"/>'
_URI = f"""<GetStreamUri xmlns="{_MEDIA}" xmlns:t="{_TYPES[1:-1]}"><StreamSetup><t:Stream>RTP-Unicast</t:Stream>
<t:Transport><t:Protocol>RTSP</t:Protocol></t:Transport></StreamSetup><ProfileToken>%s</ProfileToken></GetStreamUri>"""


@dataclass(frozen=True, slots=True)
class Offer:
    """The RTSP address of each lens of a network camera, with the login, or why there is none."""

    camera: NetworkCamera
    addresses: tuple[str, ...] = field(default=(), repr=False)
    fault: str = "gave no answer in time"


def find_streams(cameras: Sequence[NetworkCamera], login: Login | None, seconds: float = _ALL_SECONDS) -> list[Offer]:
    """The offer of each camera, asked all at the same time.

    Args:
        login: for those that want one.
        seconds: for all of them; who has not answered then is left behind.
    """
    offers = {camera: Offer(camera) for camera in cameras}

    def look(camera: NetworkCamera) -> None:
        try:
            offers[camera] = Offer(camera, stream_addresses(camera, login), "")
        except InputError as error:
            offers[camera] = Offer(camera, fault=error.fault)

    at_once([partial(look, camera) for camera in cameras], seconds)
    return [offers[camera] for camera in cameras]


def stream_addresses(camera: NetworkCamera, login: Login | None) -> tuple[str, ...]:
    """The RTSP address of the largest picture of each lens of a camera, with the login in it.

    Raises:
        InputError: it tells none, or none of its own.
    """
    if camera.service is None:
        raise InputError(camera.address, "names no address of its own to ask for its streams")
    ahead = timedelta() if login is None else _ahead(ask(camera.service, _CLOCK))
    media = (ask(camera.service, _CAPABILITIES).findtext(f".//{_TYPES}Media/{_TYPES}XAddr") or "").strip()
    if not is_service_of(camera.address, media):
        raise InputError(camera.address, "has no media service at its own address")
    tokens = _largest(ask(media, _PROFILES, login, ahead))
    if not tokens:
        raise InputError(camera.address, "offers no stream with pictures")
    answers = [ask(media, _URI % escape(token), login, ahead) for token in tokens]
    return tuple(_own(camera, (each.findtext(f".//{_TYPES}Uri") or "").strip(), login) for each in answers)


def _ahead(answer: Xml.Element) -> timedelta:
    """How far a camera's clock is ahead of ours: it refuses a login that seems to be of another time."""
    now = datetime.now(UTC)
    utc = answer.find(f".//{_TYPES}UTCDateTime")
    try:
        names = ("Year", "Month", "Day", "Hour", "Minute", "Second")
        parts = [int(utc.findtext(f".//{_TYPES}{name}", "")) for name in names] if utc is not None else []
        return datetime(*parts[:6], tzinfo=UTC) - now if parts else timedelta()  # type: ignore[misc, arg-type]
    except (ValueError, OverflowError):
        return timedelta()


def _largest(answer: Xml.Element) -> list[str]:
    """Tokens of the profiles with the largest picture of each source, the first of equal ones."""
    best: dict[str, tuple[int, str]] = {}
    namespace = f"{{{_MEDIA}}}"
    for profile in answer.findall(f".//{namespace}Profiles")[:_MAX_PROFILES]:
        token = profile.get("token", "")
        source = profile.findtext(f".//{_TYPES}VideoSourceConfiguration/{_TYPES}SourceToken", "")
        size = profile.find(f".//{_TYPES}VideoEncoderConfiguration/{_TYPES}Resolution")
        if size is None or not 0 < len(token) <= _MAX_TOKEN:
            continue
        pixels = _side(size, "Width") * _side(size, "Height")
        if pixels > best.get(source, (0, ""))[0]:
            best[source] = pixels, token
    return [token for _, token in best.values()]


def _side(size: Xml.Element, name: str) -> int:
    text = size.findtext(f"{_TYPES}{name}", "").strip()
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 5 and int(text) <= _MAX_SIDE else 0


def _own(camera: NetworkCamera, address: str, login: Login | None) -> str:
    """An RTSP address that a camera told, with the login in place of any user that it names."""
    try:
        parts = urlsplit(address)
        is_own = parts.scheme in ("rtsp", "rtsps") and parts.hostname == camera.address and parts.port != 0
    except ValueError:
        is_own = False
    if not is_own:
        raise InputError(camera.address, "names a stream that is not at its own address; give its address yourself")
    place = parts.netloc.rpartition("@")[2]
    user = "" if login is None else f"{quote(login.user, safe='')}:{quote(login.password, safe='')}@"
    found = urlunsplit(parts._replace(netloc=user + place, fragment=""))
    parse_address(found)
    return found
