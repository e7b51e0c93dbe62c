"""The table of snapshot formats: the one place that names them for the command line, the exporter and the importer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from streamlod.core.errors import InputError
from streamlod.core.files import check_output

if TYPE_CHECKING:  # the command line reads the table, and loads no arrays for it
    from streamlod.core.scene.gaussians import GaussianCloud


@dataclass(frozen=True, slots=True)
class SnapshotFormat:
    """One format of files of plain Gaussians.

    Attributes:
        name: as users write it. suffix: of its files, with the dot.
        encode: the bytes of a cloud, with a comment of one line where the format has room for it.
        decode: the cloud of a file. Both raise: ValueError on what the format cannot hold, InputError on a file that
            cannot be read.
        up: the axis of a file that `decode` makes the scene's up.
    """

    name: str
    suffix: str
    encode: Callable[[GaussianCloud, str], bytes]
    decode: Callable[[Path], GaussianCloud]
    up: str


def _encode_ply(cloud: GaussianCloud, comment: str) -> bytes:
    from streamlod.codec.export.ply import encode_ply

    return encode_ply(cloud, comment)


def _decode_ply(path: Path) -> GaussianCloud:
    from streamlod.codec.export.read_ply import decode_ply

    return decode_ply(path)


def _encode_spz(cloud: GaussianCloud, comment: str) -> bytes:
    from streamlod.codec.export.spz import encode_spz

    return encode_spz(cloud)


def _encode_spz4(cloud: GaussianCloud, comment: str) -> bytes:
    from streamlod.codec.export.spz import encode_spz

    return encode_spz(cloud, version=4)


def _decode_spz(path: Path) -> GaussianCloud:
    from streamlod.codec.export.read_spz import decode_spz

    return decode_spz(path)


def _encode_glb(cloud: GaussianCloud, comment: str) -> bytes:
    from streamlod.codec.export.fourdgs_file import encode_glb

    return encode_glb(cloud)


def _decode_glb(path: Path) -> GaussianCloud:
    from streamlod.codec.export.fourdgs_file import decode_glb

    return decode_glb(path)


FORMATS = {
    each.name: each
    for each in (
        SnapshotFormat("ply", ".ply", _encode_ply, _decode_ply, "-y"),
        SnapshotFormat("spz", ".spz", _encode_spz, _decode_spz, "y"),
        SnapshotFormat("spz4", ".spz", _encode_spz4, _decode_spz, "y"),  # the suffix alone means version 3
        SnapshotFormat("glb", ".glb", _encode_glb, _decode_glb, "y"),
    )
}
AXES = ("y", "-y", "z", "-z", "x", "-x")  # any of which may point up in a file
CLIP_SUFFIXES = {"4dgs": (".4dgs",), "usd": (".usdc", ".usda", ".usd")}  # of whole clips by format; the first is usual
PACKET_SUFFIXES = {"mp4": ".mp4", "hls": ""}  # of files, or a folder, that carry the packets themselves


def formats_called(path: Path) -> list[str]:
    """Names of the formats whose files are called so; none for a `.slod` file and for names of no known suffix."""
    suffixes = {each.name: (each.suffix,) for each in FORMATS.values()} | CLIP_SUFFIXES
    suffixes |= {name: (suffix,) for name, suffix in PACKET_SUFFIXES.items() if suffix}
    return [name for name, known in suffixes.items() if path.suffix.lower() in known]


def check_slod_output(path: Path) -> None:
    """Refuse a place where no `.slod` file can be written, or that is called like a file of another format.

    Raises:
        InputError: so it is; says what to do.
    """
    if called := formats_called(path):
        fault = f"is called like {called[0]}; name a .slod file, of which `streamlod export --format` makes that"
        raise InputError(path, fault)
    check_output(path)


def format_of(path: Path) -> SnapshotFormat | None:
    """The format that can read a file of this name; None where none can."""
    return next((each for each in FORMATS.values() if path.name.lower().endswith(each.suffix)), None)
