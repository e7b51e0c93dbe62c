"""The command `streamlod rig`: finds cameras, looks through them, and records a rig before it is calibrated."""

from __future__ import annotations

import io
import json
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamlod.core.errors import BackendUnavailable, InputError, StreamlodError
from streamlod.core.files import write_bytes, write_text
from streamlod.core.masking import masked
from streamlod.server.cli.calibrate import board_of
from streamlod.server.ingest.cameras.address import CAMERA_NAME, parse_address
from streamlod.server.ingest.cameras.sound_source import choose_sound
from streamlod.server.ingest.finding.search import NamedSource, search
from streamlod.server.ingest.statistics import trouble_of

if TYPE_CHECKING:
    from streamlod.server.ingest.cameras.definition import RigDefinition
    from streamlod.server.ingest.finding.soap import Login
    from streamlod.server.ingest.recording import WatchedRig
    from streamlod.server.service.station import Station
    from streamlod.server.settings import Settings

Say = Callable[[str], None]
_FPS = 30.0  # of phones, and of cameras that tell no rate
_WALK = "walk"  # folder beside the rig's file, which the board walk is recorded into and calibrates
_KEPT = "evenings"  # folder beside it of what is streamed
_KEPT_SECONDS = 7 * 24 * 3600
_QUORUM_FROM = 4  # cameras: with so many a stream goes on without one of them
_RECORD_SECONDS = 60.0  # of a board walk, unless another time is given
_WAIT_SECONDS = 600.0  # for all cameras of a rig to deliver


def find(
    arguments: Sequence[str],
    out: Path,
    phones: int,
    size: tuple[int, int] | None,
    fps: float | None,
    say: Say,
    *,
    sound: str | None = None,
    login: Login | None = None,
    overwrite: bool,
) -> None:
    """Write the rig's file of the sources given, or found, and a contact sheet beside it.

    Args:
        fps: pictures a second; None for those of the slowest camera, as no instant has all of them more often.
        sound: whose sound is heard: a camera's name, a microphone or a file, as docs/sound.md says.
        login: of network cameras that are found.
    """
    from streamlod.server.ingest.finding.looking import look_through
    from streamlod.server.ingest.finding.sheet import contact_sheet

    if out.exists() and not overwrite:
        raise InputError(out, "exists; give it as the argument to look through its cameras, or add --overwrite")
    sources = _named(arguments) if arguments else search(say, login)
    if not sources and not phones:
        raise InputError("rig", "found no camera whose address is known; give addresses, or --phones 4")
    looks = dict(zip(sources, look_through([each.address for each in sources], fps or _FPS, size), strict=True))
    pictures = {each.name: look.picture for each, look in looks.items()}
    cameras: list[dict[str, Any]] = []
    for each, look in looks.items():
        if look.picture is None:
            say(masked(f"{each.name}: {look.fault}; it is left out ({each.source})"))
            continue
        height, width = look.picture.shape[:2]
        say(masked(f"{each.name}: {width}x{height}, {each.source}"))
        cameras.append({"name": each.name, "source": each.source, "width": width, "height": height})
    wanted = size or (1280, 720)
    for number in range(1, phones + 1):
        cameras.append({"name": f"phone{number}", "source": "push:", "width": wanted[0], "height": wanted[1]})
    if not cameras:
        raise InputError("rig", "none of its cameras gave a picture")
    rates = sorted(look.fps for look in looks.values() if look.fps is not None)
    if rates and rates[-1] > 1.02 * rates[0]:
        say(f"they film at {rates[0]:g} to {rates[-1]:g} pictures a second: set them to one rate")
    value: dict[str, Any] = {"fps": fps or (rates[0] if rates else _FPS), "calibration": _WALK, "cameras": cameras}
    if len(cameras) >= _QUORUM_FROM:
        value["policy"] = {"quorum": len(cameras) - 1}
    if sound is None:
        say("nothing is heard; --sound NAME, a camera or a microphone, changes that")
    else:
        value["sound"] = _heard(out, sound, cameras)
    write_text(out, json.dumps(value, indent=1) + "\n", private=True)  # sources may hold passwords
    say(f"{out}: {len(cameras)} cameras; they are calibrated by the folder {_WALK}, once there is one")
    if pictures:
        sheet = out.with_suffix(".jpg")
        write_bytes(sheet, contact_sheet(pictures, {each.name: look.fault for each, look in looks.items()}))
        say(f"{sheet}: what each of them sees")
    options = f"--config {_prepared_phones(out, say)} --insecure " if phones else ""
    say(f"next: streamlod rig {out} {options}--record {out.parent / _WALK}")


def watch(
    file: Path, record_to: Path | None, seconds: float | None, settings: Settings, say: Say, *, overwrite: bool
) -> None:
    """Wait until all cameras of a rig's file deliver, write a contact sheet of one instant, and record if wanted.

    While it runs, a page of a server shows what all cameras see.

    Args:
        seconds: to record or to show; None records a minute, and shows until the user interrupts.
    """
    from streamlod.codec.sound.beside import RECORDED
    from streamlod.server.ingest.cameras.definition import read_uncalibrated
    from streamlod.server.ingest.finding.sheet import contact_sheet
    from streamlod.server.ingest.recording import first_whole, go_on, record, watching
    from streamlod.server.ingest.walk import WalkWatch

    definition = read_uncalibrated(file)
    if record_to is not None:
        _check_folder(record_to, overwrite=overwrite)
    board = board_of(None, None, record_to or file.parent)  # before anything is waited for, as its file may be damaged
    names = [camera.name for camera in definition.cameras]
    with ExitStack() as stack:
        place = _station(file, definition, settings, stack, say)
        rig = stack.enter_context(watching(definition, None if place is None else place.push_socket))
        if place is not None:
            _show(rig, place, stack, say)
        whole = first_whole(rig, _WAIT_SECONDS, lambda missing: say(_waiting(missing)))
        pictures = {each.camera: each.load() for each in whole.pictures if each is not None}
        sheet = file.with_suffix(".jpg")
        write_bytes(sheet, contact_sheet(pictures, {}))
        say(f"{sheet}: all {len(names)} cameras at one instant")

        def tell(missing: Mapping[str, str]) -> None:
            if missing:
                say(f"trouble with {trouble_of(missing)}")

        if record_to is None:
            if place is not None:
                say(f"showing them{'' if seconds is None else f' for {seconds:g} s'}; Ctrl-C ends it")
                go_on(rig, seconds, tell)
            return
        seconds = _RECORD_SECONDS if seconds is None else seconds
        say(f"recording {seconds:g} s into {record_to}; Ctrl-C ends it earlier")
        record_to.mkdir(parents=True, exist_ok=True)
        pool = stack.enter_context(ThreadPoolExecutor(1, "walk"))
        walk = WalkWatch(names, board, say, rig.show, pool)
        found = record(rig, definition, record_to, seconds, tell, walk.look)
        walk.end()
    for name, one in found.cameras.items():
        slow = f", {one.left_out} left out as this machine was too slow" if one.left_out else ""
        say(f"{record_to / name}.mp4: {one.pictures} pictures{slow}")
    if found.sound_seconds == 0:
        say(f"no sound was recorded: nothing came of {definition.sound_name}")
    elif found.sound_seconds is not None:
        say(f"{record_to / RECORDED}: {found.sound_seconds:.0f} s of sound of {definition.sound_name}")
    say(f"next: streamlod calibrate {record_to}, with charuco.toml of the printed board beside or --board FILE")


def _show(rig: WatchedRig, place: Station, stack: ExitStack, say: Say) -> None:
    from streamlod.server.ingest.showing import showing

    stack.enter_context(showing(rig, place.show))
    say(f"what all cameras see: {place.overview}")


def _station(file: Path, definition: RigDefinition, settings: Settings, stack: ExitStack, say: Say) -> Station | None:
    """A server, held by `stack`, for the rig's phones, which `say` is told the pages of, and its page of all cameras.

    A rig without phones does without where there can be none, as where another server has its port.
    """
    phones = _phones(definition)
    try:
        from streamlod.server.service.station import station

        place = stack.enter_context(station(settings, file))
    except (StreamlodError, ImportError) as error:
        if phones:
            raise
        say(f"no page shows the cameras ({error})")
        return None
    if phones:
        _show_pages(place.pages(phones), say)
    return place


def _heard(out: Path, name: str, cameras: Sequence[Mapping[str, Any]]) -> str:
    """The rig's field `sound`, checked; a file is named from the root, as the cameras' are."""
    found = choose_sound(out, name, {each["name"]: parse_address(each["source"]) for each in cameras}, name)
    is_file = found.address is not None and found.address.scheme == "file" and Path(name).is_file()
    return str(Path(name).absolute()) if is_file else name


def _named(arguments: Sequence[str]) -> list[NamedSource]:
    found: list[NamedSource] = []
    for argument in arguments:
        name, equals, source = argument.partition("=")
        if not (equals and re.fullmatch(CAMERA_NAME, name)):
            name, source = f"cam{len(found) + 1}", argument
        parsed = parse_address(source)
        if parsed.scheme == "push":
            raise InputError(f"source {argument!r:.80}", "is no address; for cameras that are pushed, give --phones")
        if any(each.name == name for each in found):
            raise InputError(f"camera {name}", "is named twice")
        found.append(NamedSource(name, str(Path(source).absolute()) if parsed.scheme == "file" else source))
    return found


def _prepared_phones(out: Path, say: Say) -> Path:
    """Settings, made where there are none: with a certificate, without which phones give no page their camera, a secret
    that keeps a phone's link good for each server of the evening, and a folder that keeps for a week what is streamed.
    """
    from streamlod.server.service.addresses import own_address
    from streamlod.server.service.self_signed import write_self_signed

    ends = (".toml", "-certificate.pem", "-key.pem", "-links.key")
    config, certificate, key, links = (out.with_name(out.stem + end) for end in ends)
    if not config.exists():
        write_self_signed(certificate, key, own_address())
        write_text(links, secrets.token_hex(), private=True)
        places = {"certificate": certificate, "certificate_key": key, "link_key": links, "state": out.with_name(_KEPT)}
        lines = {"host": "0.0.0.0"} | {name: str(place.absolute()) for name, place in places.items()}
        text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in lines.items())
        write_text(config, f"{text}\n[retention]\nseconds = {_KEPT_SECONDS}\n")
        say(f"{config}: settings of the server, with a certificate of its own making; what it streams goes to {_KEPT}")
    return config


def _phones(definition: RigDefinition) -> list[str]:
    cameras = zip(definition.cameras, definition.addresses, strict=True)
    return [camera.name for camera, address in cameras if address.scheme == "push"]


def phones_socket(file: Path, definition: RigDefinition, settings: Settings, stack: ExitStack, say: Say) -> Path | None:
    """The socket to which a server, held by `stack`, relays what the rig's phones film; None for a rig without phones.

    `say` is told the addresses of the phones' pages.
    """
    place = _station(file, definition, settings, stack, say) if _phones(definition) else None
    return None if place is None else place.push_socket


def _show_pages(pages: Mapping[str, str], say: Say) -> None:
    """The addresses for phones, each as a QR code."""
    try:
        import segno
    except ImportError as error:
        raise BackendUnavailable("QR codes", "install them: pip install 'streamlod[serve]'") from error
    for name, address in pages.items():
        code = io.StringIO()
        segno.make(address, error="l", micro=False).terminal(code, compact=True, border=2)
        say(f"{code.getvalue()}{name or 'each phone'}: {address}")
    if any(address.startswith("http://") for address in pages.values()):
        say("phones give their camera to pages with https only: name a certificate in the settings (--config)")


def _waiting(missing: Mapping[str, str]) -> str:
    return f"waiting for {trouble_of(missing)}" if missing else "waiting for all cameras to film at the same time"


def _check_folder(folder: Path, *, overwrite: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "is not a folder")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(folder, "is not empty; name another folder, or add --overwrite")
