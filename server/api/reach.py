"""Which files and networks a stream that is created over REST may reach: those of the settings, and nothing else.

Of the state folder it may read the recordings of streams that its creator may watch.

Whoever may control streams is not for that reason allowed to read every file of the server or to talk to its network.
Streams of the command line and the settings file are not held to this: who writes those has the machine.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from streamlod.core.errors import InputError
from streamlod.server.auth.gate import Grant, Right
from streamlod.server.http.networks import is_reachable
from streamlod.server.ingest.cameras.address import PUSH, local_file
from streamlod.server.pipeline.job import POINT_METHODS
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings

_OPTIONS_IN_QUERY = ("tcp", "udp", "srt")  # whose addresses tell FFmpeg more than where to
_HARMLESS = {"mode", "latency", "passphrase", "pbkeylen", "streamid", "timeout", "pkt_size", "fifo_size", "buffer_size"}
_DEVICES = {"v4l2": None, "alsa": "/dev/snd"}  # what has to be among the files that may be read
_REDIRECTED = ("rtsp", "rtsps")  # where FFmpeg goes wherever the camera sends it


def check_reach(spec: StreamSpec, settings: Settings, grant: Grant) -> None:
    """Refuse a stream that leads to other files, networks or listening addresses than settings and `grant` allow.

    Nothing is opened or looked up, so that a refusal does not tell what exists.

    Raises:
        InputError: it does; the sentence names the field and the setting.
    """
    job = spec.job
    paths: dict[str, Any] = {"play": spec.play}
    if job is not None:
        paths |= {"data": job.data, "points": None if job.points in POINT_METHODS else job.points}
        if isinstance(job.live, dict):
            _check_rig(job.live, settings, grant)
        else:
            paths["live"] = job.live
    for name, path in paths.items():
        if path is not None:
            _check_path(name, path, settings, grant)


def _check_path(name: str, path: object, settings: Settings, grant: Grant) -> None:
    try:
        found = Path(str(path)).resolve()
        inside = _is_readable(found, settings, grant)
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, or a circle of links
        inside = False
    if not inside:
        raise InputError(name, "is in none of the folders that streams may read; add its folder to the setting `roots`")


def _is_readable(path: Path, settings: Settings, grant: Grant) -> bool:
    """Whether a resolved path may be read.

    The state folder has a rule of its own, wherever it lies: what is in the folders of streams that may be watched.
    """
    if settings.state is not None and path.is_relative_to(settings.state.resolve()):
        below = path.relative_to(settings.state.resolve()).parts
        return len(below) > 2 and below[0] == "streams" and grant.allows(Right.READ, below[1])
    return any(path.is_relative_to(root.resolve()) for root in settings.roots)


def _check_rig(rig: dict[str, Any], settings: Settings, grant: Grant) -> None:
    if rig.get("calibration") is not None:
        _check_path("live.calibration", rig["calibration"], settings, grant)
    listed, names = rig.get("cameras"), []
    for number, camera in enumerate(listed if isinstance(listed, list) else []):
        if isinstance(camera, dict):
            names.append(camera.get("name"))
            if isinstance(source := camera.get("source"), str):
                _check_source(f"live.cameras.{number}.source", source, settings, grant)
    sound = rig.get("sound")
    if isinstance(sound, str) and sound not in names:
        _check_source("live.sound", sound, settings, grant)


def _check_source(name: str, source: str, settings: Settings, grant: Grant) -> None:
    if source.startswith(PUSH):
        return
    path = local_file(source)
    if path is not None:
        _check_path(name, path, settings, grant)
        return
    try:
        parts = urlsplit(source)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError as error:
        raise InputError(name, "is not a URL") from error
    if parts.scheme in _DEVICES:
        _check_path(name, _DEVICES[parts.scheme] or parts.path, settings, grant)
        return
    listens = parts.scheme.endswith("+listen") or parts.scheme == "udp"
    if parts.scheme.partition("+")[0] in _OPTIONS_IN_QUERY:
        options = _query(source)
        if strange := sorted(options.keys() - _HARMLESS):
            raise InputError(name, f"has the option {strange[0]!r:.40}, which a stream created by REST may not set")
        listens = listens or options.get("mode", "caller") != "caller"
    if listens:
        if f"{host}:{port}" not in settings.listen:
            raise InputError(name, "listens at an address that is not in the setting `listen`, as ADDRESS:PORT")
    elif not is_reachable(host, settings.networks, public=parts.scheme not in _REDIRECTED):
        raise InputError(
            name, "is at an address that cameras may not be at; add its network, or its name, to the setting `networks`"
        )


def _query(source: str) -> dict[str, str]:
    """Options after the first question mark, as FFmpeg reads them: `#` is no end."""
    pairs = (pair.partition("=") for pair in source.partition("?")[2].split("&") if pair)
    return {name.lower(): value.lower() for name, _, value in pairs}
