"""Where the sound of a `.slod` file lies, and the beginning of such a file, read without a media library."""

from __future__ import annotations

import json
import re
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError

BEGIN_COMMENT = "STREAMLOD_BEGIN_NS"
RECORDED = "sound.opus"  # of a recorded rig, in the folder of its cameras' videos and on their clock
CAMERA_COMMENT = "STREAMLOD_CAMERA"
MAX_CAMERA_NAME = 255  # characters
MAX_TIME_NS = 2**63 - 1
MEDIA_TYPE = "audio/ogg"
_HEAD_BYTES = 4096  # both headers and their pages, where comments are as short as ours
_HEAD = re.compile(rb"OggS\0.{21}\x01\x13OpusHead\x01([\x01\x02])", re.DOTALL)
_BEGIN = re.compile(BEGIN_COMMENT.encode() + rb"=([0-9]{1,19})(?![0-9])", re.IGNORECASE)
_CAMERA = re.compile(CAMERA_COMMENT.encode() + rb'=("(?:[^"\\]|\\.)*")', re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class SoundFile:
    """An Ogg Opus file that belongs to a stream.

    Attributes:
        path: the file.
        begin_ns: time of its first sample, on the clock of the packets' times.
        channels: 1 or 2.
        size_bytes, changed_ns: of the file when it was looked at.
        camera: name of the camera at which the microphone stood; None where that is not known.
    """

    path: Path
    begin_ns: int
    channels: int
    size_bytes: int
    changed_ns: int
    camera: str | None = None

    def facts(self, *, live: bool) -> dict[str, Any]:
        """Facts that viewers are told, as in docs/protocol.md."""
        return {"begin_ns": self.begin_ns, "channels": self.channels, "live": live, "camera": self.camera}


def sound_beside(slod: Path) -> Path:
    """The name of the file that holds the sound of the `.slod` file `slod`, whether it exists or not."""
    return slod.with_name(f"{slod.name}.opus")


def look_at_sound(path: Path) -> SoundFile:
    """Facts of a file of sound from its first bytes; a file without a begin comment begins at 0.

    Raises:
        InputError: missing, no regular file, or not Ogg Opus of one or two channels.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(path, "is no file")
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    found = _HEAD.match(head)
    if found is None:
        raise InputError(path, "is not Ogg Opus with one or two channels; make it with streamlod train --sound")
    begin = _BEGIN.search(head)
    begin_ns = 0 if begin is None else int(begin[1])
    if begin_ns > MAX_TIME_NS:
        raise InputError(path, f"says that it begins at {begin_ns} ns, which no clock shows")
    return SoundFile(path, begin_ns, found[1][0], status.st_size, status.st_mtime_ns, _camera_in(head))


def comments(begin_ns: int, camera: str | None) -> dict[str, str]:
    """The comments of a file of sound; the name is a JSON string, as that says where it ends."""
    begin = {BEGIN_COMMENT: str(begin_ns)}
    return begin if camera is None else begin | {CAMERA_COMMENT: json.dumps(camera)}


def _camera_in(head: bytes) -> str | None:
    found = _CAMERA.search(head)
    with suppress(ValueError):  # no JSON: it is not ours
        name = None if found is None else json.loads(found[1])
        if name and len(name) <= MAX_CAMERA_NAME and name.isprintable():
            return str(name)
    return None


def find_sound(slod: Path) -> SoundFile | None:
    """The sound of the `.slod` file `slod`; None where there is none that can be used.

    It has to lie in the folder itself: a link leads to what nobody allowed to be read.
    """
    try:
        path = sound_beside(slod.resolve())
        return None if path.is_symlink() else look_at_sound(path)
    except (InputError, OSError, ValueError, RuntimeError):  # the last two: a name with a NUL, a circle of links
        return None
