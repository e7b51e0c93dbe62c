"""The machine around the service: cores, memory, disk, ports, clock and video decoders."""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from streamlod.core.files import nearest_folder
from streamlod.server.doctor.finding import Finding, Verdict

MIN_MEMORY_GIB, MIN_DISK_GIB = 4.0, 5.0
_DECODERS = ("h264", "hevc", "mjpeg", "av1")
_CLOCK_UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)


def check_host(host: str, port: int, state: Path | None) -> Iterator[Finding]:
    """Cores and memory, the disk of recordings, the port to listen on, the clock, and video decoders.

    Args:
        host, port: where the service would listen.
        state: folder of recordings, or None where nothing is recorded.
    """
    yield _processor()
    yield _disk(state if state is not None else Path(tempfile.gettempdir()))
    yield _port(host, port)
    yield _clock()
    yield _decoders()


def usable_cores() -> int:
    """Processor cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _processor() -> Finding:
    cores = usable_cores()
    gibibytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    found = f"{cores} cores, {gibibytes:.1f} GiB of memory"
    if gibibytes < MIN_MEMORY_GIB:
        return Finding("processor", Verdict.WARNING, found, f"training wants {MIN_MEMORY_GIB:.0f} GiB or more")
    return Finding("processor", Verdict.OK, found)


def _disk(folder: Path) -> Finding:
    check = f"disk {folder}"
    place = nearest_folder(folder)
    free = shutil.disk_usage(place).free / 2**30
    if not os.access(place, os.W_OK):
        return Finding(check, Verdict.FAULT, "cannot be written", "choose another --state-dir, or change its owner")
    if free < MIN_DISK_GIB:
        return Finding(check, Verdict.WARNING, f"{free:.1f} GiB free", "recordings soon fill it: free some space")
    return Finding(check, Verdict.OK, f"{free:.1f} GiB free")


def _port(host: str, port: int) -> Finding:
    check = f"port {port}"
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
    except OSError as error:
        found = f"{host} does not let it be used ({error.strerror})"
        return Finding(check, Verdict.WARNING, found, "choose another with --port, or stop what listens there")
    return Finding(check, Verdict.OK, f"free on {host}")


def _clock() -> Finding:
    """Whether the system clock follows a time source: network cameras are paired by time."""
    if sys.platform != "linux":
        return Finding("clock", Verdict.ABSENT, f"not examined on {sys.platform}", "keep it set by NTP")
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(512))  # all zero: only asks
    if state in (-1, _CLOCK_UNSYNCHRONISED):
        return Finding("clock", Verdict.WARNING, "follows no time source", "run an NTP client where cameras are paired")
    return Finding("clock", Verdict.OK, "follows a time source")


def _decoders() -> Finding:
    import av

    there = [name for name in _DECODERS if name in av.codecs_available]
    lacking = [name for name in _DECODERS if name not in there]
    if lacking:
        return Finding("video decoders", Verdict.WARNING, f"no {', '.join(lacking)}", "install av from PyPI's wheels")
    return Finding("video decoders", Verdict.OK, ", ".join(there))
