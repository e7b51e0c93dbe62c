"""Which files and networks a stream that is created over REST may reach: those of the settings, and nothing else.

Whoever may control streams is not for that reason allowed to read every file of the server or to talk to its network.
Streams of the command line and the settings file are not held to this: who writes those has the machine.
"""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from core.errors import InputError
from server.pipeline.spec import StreamSpec
from server.settings import Settings

POINT_METHODS = {"auto", "colmap", "sweep", "colmap+sweep", "vggt", "random"}


def check_reach(spec: StreamSpec, settings: Settings) -> None:
    """Refuse a stream that leads to other files, networks or listening addresses than the settings allow.

    Nothing is opened or looked up, so that a refusal does not tell what exists.

    Raises:
        InputError: it does; the sentence names the field and the setting.
    """
    job = spec.job
    paths: dict[str, Any] = {"play": spec.play}
    if job is not None:
        paths |= {"data": job.data, "points": None if job.points in POINT_METHODS else job.points}
        if isinstance(job.live, dict):
            _check_rig(job.live, settings)
        else:
            paths["live"] = job.live
    for name, path in paths.items():
        if path is not None:
            _check_path(name, path, settings)


def _check_path(name: str, path: object, settings: Settings) -> None:
    try:
        found = Path(str(path)).resolve()
        inside = any(found.is_relative_to(root.resolve()) for root in settings.readable_folders)
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, or a circle of links
        inside = False
    if not inside:
        raise InputError(name, "is in none of the folders that streams may read; add its folder to the setting `roots`")


def _check_rig(rig: dict[str, Any], settings: Settings) -> None:
    if rig.get("calibration") is not None:
        _check_path("live.calibration", rig["calibration"], settings)
    cameras = rig.get("cameras")
    for number, camera in enumerate(cameras if isinstance(cameras, list) else []):
        source = camera.get("source") if isinstance(camera, dict) else None
        if isinstance(source, str):
            _check_source(f"live.cameras.{number}.source", source, settings)


def _check_source(name: str, source: str, settings: Settings) -> None:
    if source == "push:" or source.startswith("push://"):
        return
    try:
        parts = urlsplit(source)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError as error:
        raise InputError(name, "is not a URL") from error
    if "://" not in source or parts.scheme in ("file", "v4l2"):
        _check_path(name, source if "://" not in source else parts.path, settings)
    elif parts.scheme.endswith("+listen") or parts.scheme == "udp" or "mode=listener" in parts.query.lower():
        if f"{host}:{port}" not in settings.listen:
            raise InputError(name, "listens at an address that is not in the setting `listen`, as ADDRESS:PORT")
    elif not is_reachable(host, settings.networks):
        raise InputError(
            name, "is at an address that cameras may not be at; add its network, or its name, to the setting `networks`"
        )


def is_reachable(host: str, networks: tuple[str, ...]) -> bool:
    """Whether cameras may be at `host`: a public numeric address, or what `networks` lists.

    A name counts only if it is listed itself, as it may mean another address whenever it is asked for.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host in networks
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    listed = [ipaddress.ip_network(network) for network in networks if "/" in network]
    if any(address in network for network in listed):
        return True
    return address.is_global and not address.is_multicast
