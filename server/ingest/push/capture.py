"""The pictures of a capture node's camera: encoded, with the time at which each was taken."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import av
import cv2

from streamlod.core.camera.grid import period_of
from streamlod.core.data.names import files_in, numeric_key
from streamlod.core.data.video import SUFFIXES
from streamlod.core.data.video.decoding import played_pictures
from streamlod.core.data.video.times import pictures_of
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address, parse_address, webcam_options
from streamlod.server.ingest.push.message import Codec

_PICTURES = {".jpg": Codec.JPEG, ".jpeg": Codec.JPEG, ".png": Codec.PNG}
_JPEG_QUALITY = 92
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Taken:
    """A captured picture: capture time in nanoseconds since 1970, and the encoded picture."""

    capture_ns: int
    codec: Codec
    body: bytes


@dataclass(frozen=True, slots=True)
class CaptureCamera:
    """A camera of a capture node.

    Attributes:
        name: as in the rig's definition.
        source: a folder of pictures, or where PyAV reads them.
        fps: of folders and files without times, and asked of webcams.
        size: (width, height) asked of webcams, or None for their default.
        repeats: whether files and folders start again at their end.
    """

    name: str
    source: Path | Address
    fps: float
    size: tuple[int, int] | None = None
    repeats: bool = False

    def pictures(self, start_ns: int) -> Iterator[Taken]:
        """Pictures as they are taken; the first of a file or folder at `start_ns`, the others at their pace.

        Raises:
            InputError: the source cannot be read, or ends although it is live.
        """
        while True:
            last = start_ns
            for taken in self._from_folder(start_ns) if isinstance(self.source, Path) else self._from_stream(start_ns):
                last = taken.capture_ns
                yield taken
            if not self.repeats:
                return
            start_ns = last + round(period_of(self.fps))

    def _from_folder(self, start_ns: int) -> Iterator[Taken]:
        assert isinstance(self.source, Path)
        for number, path in enumerate(_pictures_in(self.source)):
            capture = start_ns + round(number * period_of(self.fps))
            _sleep_until(capture)
            yield Taken(capture, _PICTURES[path.suffix.lower()], path.read_bytes())

    def _from_stream(self, start_ns: int) -> Iterator[Taken]:
        address = self.source
        assert isinstance(address, Address)
        options = webcam_options(self.fps, self.size) if address.scheme == "v4l2" else address.options
        try:
            with closing(av.open(address.url, "r", format=address.format, options=options)) as container:
                stream = pictures_of(container)
                if stream is None:
                    raise InputError(address.url, "holds no pictures, only other streams")
                if not address.is_live:
                    rate = _SECOND_NS / period_of(self.fps)
                    for since_begin_ns, frame in played_pictures(container, stream, rate):
                        capture = start_ns + since_begin_ns
                        _sleep_until(capture)
                        yield Taken(capture, Codec.JPEG, _jpeg(frame))
                    return
                for packet in container.demux(stream):
                    arrival = time.time_ns()
                    for frame in packet.decode():
                        assert isinstance(frame, av.VideoFrame)
                        yield Taken(arrival, Codec.JPEG, _jpeg(frame))
        except (av.FFmpegError, OSError) as error:
            raise InputError(address.url, f"cannot be read ({error.strerror or error})") from error
        raise InputError(address.url, "has ended")


def find_cameras(
    sources: list[str], fps: float, size: tuple[int, int] | None = None, *, repeats: bool = False
) -> tuple[CaptureCamera, ...]:
    """The cameras that arguments name.

    Args:
        sources: ``NAME=SOURCE`` (a video, a folder of pictures, or a URL as in docs/ingest.md), or a folder, in which
            every video and every folder of pictures is a camera of that name.

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
        if isinstance(place, Path) and not _pictures_in(place):
            raise InputError(place, "holds no JPEG or PNG picture")
    return tuple(CaptureCamera(name, place, fps, size, repeats) for name, place in named)


def _cameras_in(folder: Path) -> list[tuple[str, Path | Address]]:
    shown = (child for child in folder.iterdir() if not child.name.startswith("."))
    children = sorted(shown, key=lambda child: numeric_key(child.name))
    found: list[tuple[str, Path | Address]] = [
        (child.stem, _address(str(child))) for child in children if child.suffix.lower() in SUFFIXES
    ]
    found += [(child.name, child) for child in children if child.is_dir() and _pictures_in(child)]
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


def _pictures_in(folder: Path) -> list[Path]:
    return files_in(folder, tuple(_PICTURES))


def _jpeg(frame: av.VideoFrame) -> bytes:
    ok, data = cv2.imencode(".jpg", upright(frame, "bgr24"), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert ok
    return data.tobytes()


def _sleep_until(capture_ns: int) -> None:
    time.sleep(max(0.0, (capture_ns - time.time_ns()) / 1e9))
