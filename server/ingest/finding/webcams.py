"""Cameras at this machine, as Linux lists them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_LIST = Path("/sys/class/video4linux")
_DEVICE = re.compile(r"video(\d{1,3})")
_MAX_NAME = 64  # characters


@dataclass(frozen=True, slots=True)
class Webcam:
    """A camera: the number of its device, and the name its driver gives it."""

    number: int
    name: str

    @property
    def source(self) -> str:
        """Its address as docs/ingest.md writes it."""
        return f"v4l2:///dev/video{self.number}"


def find_webcams(listed: Path = _LIST) -> tuple[Webcam, ...]:
    """The cameras of this machine, by number; a camera's further devices, which give no pictures, are left out."""
    found = []
    for folder in listed.glob("video*"):
        match = _DEVICE.fullmatch(folder.name)
        if match is not None and _text(folder / "index") in ("", "0"):
            found.append(Webcam(int(match[1]), _text(folder / "name")[:_MAX_NAME]))
    return tuple(sorted(found, key=lambda webcam: webcam.number))


def _text(file: Path) -> str:
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""
