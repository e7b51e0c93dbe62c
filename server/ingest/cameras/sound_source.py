"""Which sound a rig's file asks for: that of one of its cameras, of a microphone, or of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address, parse_address


@dataclass(frozen=True, slots=True)
class SoundSource:
    """A rig's sound.

    Attributes:
        name: as the rig's file has it.
        camera: whose connection brings it; None where it is read by itself.
        address: where it is read by itself; None where a camera brings it.
    """

    name: str
    camera: str | None
    address: Address | None


def choose_sound(path: Path, name: str, cameras: Mapping[str, Address], beside: str) -> SoundSource:
    """The sound that `name` names: a camera's, or that of a source.

    Args:
        path: the rig's file.
        cameras: addresses of the rig's cameras, by name.
        beside: `name` as a source, taken from the file's folder.

    Raises:
        InputError: no such camera or file, or one that cannot have sound.
    """
    address = cameras.get(name)
    if address is not None:
        if address.scheme == "v4l2":
            fault = f"takes its sound of camera {name}, but webcams give none; name its microphone, as alsa:///default"
            raise InputError(path, fault)
        return SoundSource(name, None, address) if address.scheme == "file" else SoundSource(name, name, None)
    address = parse_address(beside)
    if address.scheme in ("push", "v4l2"):
        raise InputError(path, f"takes its sound of {name}, which gives none by itself; name a camera or a microphone")
    if address.scheme == "file" and not Path(address.url).is_file():
        known = ", ".join(cameras)
        raise InputError(path, f"takes its sound of {name!r:.80}, which is neither a camera ({known}) nor a file")
    return SoundSource(name, None, address)
