"""Parses the URL of a camera: which reader, which options."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

from streamlod.core.errors import InputError

LISTEN_SECONDS = 5.0  # then the port is opened again, so that a reader can be stopped
OPEN_SECONDS = 10.0
SILENCE_SECONDS = 8.0  # a connection without data for so long counts as dead
PUSH = "push:"  # the source of a camera that a phone or capture node pushes
CAMERA_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"  # pattern of the name of a rig's camera
CAMERA_NAME_WORDS = "1 to 64 letters, digits, _, . or -, the first a letter or digit"
_MAX_LENGTH = 2048
_LIVE = {"fflags": "nobuffer", "probesize": "200000", "analyzeduration": "500000"}
_DEVICES = {  # what FFmpeg opens by a name of this machine; ALSA's may name files otherwise
    "v4l2": (re.compile(r"/dev/video\d{1,3}"), "names no camera; write v4l2:///dev/video0"),
    "alsa": (
        re.compile(r"/(default|sysdefault|pulse|pipewire|(plug)?hw:\d{1,2}(,\d{1,2})?)"),
        "names no microphone; write alsa:///default or alsa:///hw:1,0",
    ),
}
_PROTOCOLS = {  # protocols that FFmpeg may open; a playlist must not lead to files
    "rtsp": "rtsp,rtp,rtcp,udp,tcp",
    "rtsps": "rtsps,rtsp,rtp,rtcp,tls,tcp",
    "rtmp": "rtmp,tcp",
    "http": "http,tcp",
    "https": "https,http,tls,tcp",
    "udp": "udp",
    "tcp": "tcp",
}
_LISTENING = {
    "rtsp": {"rtsp_flags": "listen", "listen_timeout": str(round(LISTEN_SECONDS))},
    "rtmp": {"listen": "1"},
    "http": {"listen": "1"},
    "tcp": {"listen": "1"},
}
_FORMATS = "mpegts,mpjpeg,mjpeg,flv,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,h264,hevc"
_CONFINED = {name: {"max_redirects": "0", "format_whitelist": _FORMATS} for name in ("http", "https")}  # no playlist
SCHEMES = (
    "a file, rtsp, rtsps, rtmp, http, https, udp, tcp, srt, v4l2, alsa or push, or rtsp, rtmp, http or tcp with +listen"
)


@dataclass(frozen=True, slots=True)
class Address:
    """Where pictures come from.

    Attributes:
        url: as FFmpeg takes it; empty for push.
        scheme: file, push, srt, v4l2, alsa, or a network protocol.
        listens: whether the camera connects to us.
        format: of the container, where FFmpeg has to be told.
        options: for FFmpeg's demuxer.
    """

    url: str
    scheme: str
    listens: bool = False
    format: str | None = None
    options: dict[str, str] = field(default_factory=dict)

    @property
    def is_live(self) -> bool:
        """Whether the source has no end."""
        return self.scheme != "file"

    @property
    def open_seconds(self) -> float | None:
        """How long opening may take; None for RTSP, where FFmpeg has its own limit and refuses a second."""
        if self.listens:
            return None if self.scheme == "rtsp" else LISTEN_SECONDS
        return OPEN_SECONDS


def parse_address(source: str) -> Address:
    """The address that a URL or a file's path stands for.

    Raises:
        InputError: an unknown scheme, or no place after it.
    """
    if not source or len(source) > _MAX_LENGTH or not source.isprintable():
        raise InputError(
            f"source {source!r:.80}", f"must be a URL or a path of 1 to {_MAX_LENGTH} printable characters"
        )
    if source.startswith(PUSH):
        if source not in (PUSH, f"{PUSH}//"):
            raise InputError(f"source {source!r:.80}", f"says more than {PUSH}; leave that out, as who films says it")
        return Address("", "push")
    path = local_file(source)
    if path is not None:
        return Address(str(path.absolute()), "file", options={"protocol_whitelist": "file"})
    try:
        parts = urlsplit(source)
        place = parts.netloc and (parts.port is None or parts.port > 0)
    except ValueError as error:
        raise InputError(f"source {source!r:.80}", f"is not a URL ({error})") from error
    base, _, mode = parts.scheme.partition("+")
    listens = mode == "listen" and base in _LISTENING
    if (mode and not listens) or base not in {*_PROTOCOLS, *_DEVICES, "srt"}:
        raise InputError(f"source {source!r:.80}", f"has an unknown scheme; use {SCHEMES}")
    if base in _DEVICES:
        return _device(source, base)
    if not place:
        raise InputError(f"source {source!r:.80}", "names no host")
    url = source.replace("+listen", "", 1) if listens else source
    if base == "srt":
        return Address(url, "srt", format="mpegts", options=dict(_LIVE))
    options = {**_LIVE, "protocol_whitelist": _PROTOCOLS[base], **_CONFINED.get(base, {})}
    if base in ("rtsp", "rtsps"):
        options["rtsp_transport"] = "tcp"
    if listens:
        options |= _LISTENING[base]
    return Address(url, base, listens, "mpegts" if base in ("udp", "tcp") else None, options)


def local_file(source: str) -> Path | None:
    """The file that a path, which may hold colons, or a file URL (RFC 8089) stands for; None for any other address.

    Raises:
        InputError: a file URL of another machine, or with parts that no file has.
    """
    if source.startswith(PUSH):
        return None
    if not source.lower().startswith("file:/"):
        return Path(source) if "://" not in source else None
    try:
        parts = urlsplit(source)
        path = unquote(parts.path, errors="strict")
    except ValueError as error:
        raise InputError(f"source {source!r:.80}", f"is not a URL ({error})") from error
    if parts.query or parts.fragment:
        fault = "has a ? or # in its path; write %3F or %23 there, or the path without file://"
        raise InputError(f"source {source!r:.80}", fault)
    if parts.netloc.lower() not in ("", "localhost") or not path.isprintable():
        raise InputError(f"source {source!r:.80}", "is no file of this machine; write file:///folder/cam.mp4")
    return Path(path)


def webcam_options(fps: float, size: tuple[int, int] | None) -> dict[str, str]:
    """FFmpeg's options for a webcam: pictures a second, and (width, height), None for the webcam's default."""
    options = {"framerate": f"{fps:g}"}
    return options if size is None else options | {"video_size": f"{size[0]}x{size[1]}"}


def _device(source: str, scheme: str) -> Address:
    form, fault = _DEVICES[scheme]
    _, _, path = source.partition("://")  # no host before it, and no options behind: nothing would heed them
    if not form.fullmatch(path):
        raise InputError(f"source {source!r:.80}", fault)
    return Address(path if scheme == "v4l2" else path[1:], scheme, format=scheme)
