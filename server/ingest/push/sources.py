"""The cameras of a capture node that arguments name, and when those that repeat begin again."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import av

from streamlod.core.camera.grid import period_of
from streamlod.core.data.names import numeric_key
from streamlod.core.data.video import SUFFIXES
from streamlod.core.data.video.decoding import played_from
from streamlod.core.data.video.times import PictureTimes
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address, parse_address
from streamlod.server.ingest.push.capture import SECOND_NS, CaptureCamera, picture_numbers, pictures_in, video_of


def find_cameras(
    sources: list[str], fps: float, size: tuple[int, int] | None = None, *, repeats: bool = False
) -> tuple[CaptureCamera, ...]:
    """The cameras that arguments name.

    Args:
        sources: ``NAME=SOURCE`` (a video, a folder of pictures, or a URL as in docs/ingest.md), or a folder, in which
            every video and every folder of pictures is a camera of that name.
        repeats: whether files and folders start again, all at once, when the longest one has ended.

    Raises:
        InputError: a source that cannot be one, or two of one name.
    """
    named: list[tuple[str, Path | Address]] = []
    for argument in sources:
        name, equals, source = argument.partition("=")
        if equals and name.replace("_", "").replace("-", "").replace(".", "").isalnum():
            path = Path(source)
            named.append((name, path if path.is_dir() else _address(source)))
        elif Path(argument).is_dir():
            named += _cameras_in(Path(argument))
        else:
            raise InputError(f"source {argument!r:.80}", "is not a folder; write NAME=SOURCE for a single camera")
    for name, place in named:
        if sum(other == name for other, _ in named) > 1:
            raise InputError(f"camera {name}", "is named twice")
        if isinstance(place, Path) and not pictures_in(place):
            raise InputError(place, "holds no JPEG or PNG picture")
    if size is not None and not any(isinstance(place, Address) and place.scheme == "v4l2" for _, place in named):
        raise InputError("size", "is asked of webcams, of which there is none; others are sent as they are")
    longest_ns = max(_length_ns(place, fps) for _, place in named) if repeats else None
    return tuple(CaptureCamera(name, place, fps, size, longest_ns) for name, place in named)


def _length_ns(source: Path | Address, fps: float) -> int:
    """Nanoseconds from the beginning of a file or folder to where a further picture would be; 0 if live."""
    if isinstance(source, Path):
        return round((picture_numbers(pictures_in(source))[-1] + 1) * period_of(fps))
    if source.is_live:
        return 0
    try:
        with closing(av.open(source.url, "r", format=source.format, options=source.options)) as container:
            stream = video_of(container, source)
            times = PictureTimes(container, stream, SECOND_NS / period_of(fps))
            sampled = (times.sample(packet) for packet in container.demux(stream) if packet.size)
            found = [time_ns for time_ns in sampled if time_ns is not None]
    except (av.FFmpegError, OSError) as error:
        raise InputError(source.url, f"cannot be read ({error.strerror or error})") from error
    if not found:
        raise InputError(source.url, "holds no picture with a time")
    begin_ns, last_ns = played_from(min(found)), max(found)
    return last_ns - begin_ns + round((last_ns - min(found)) / max(1, len(found) - 1))


def _cameras_in(folder: Path) -> list[tuple[str, Path | Address]]:
    shown = (child for child in folder.iterdir() if not child.name.startswith("."))
    children = sorted(shown, key=lambda child: numeric_key(child.name))
    found: list[tuple[str, Path | Address]] = [
        (child.stem, _address(str(child))) for child in children if child.suffix.lower() in SUFFIXES
    ]
    found += [(child.name, child) for child in children if child.is_dir() and pictures_in(child)]
    if not found:
        raise InputError(folder, "holds no video and no folder of pictures")
    return found


def _address(source: str) -> Address:
    address = parse_address(source)
    if address.scheme in {"push", "srt"} or address.listens:
        raise InputError(f"source {source!r:.80}", "cannot be read by a capture node; let the server read it")
    if address.scheme == "file" and not Path(address.url).is_file():
        raise InputError(address.url, "does not exist")
    return address
