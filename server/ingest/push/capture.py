"""The pictures of a capture node's camera: encoded, with the time at which each was taken."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import av
import av.container
import av.video.stream
import cv2

from streamlod.core.camera.grid import period_of
from streamlod.core.data.names import files_in, instant_numbers
from streamlod.core.data.video.decoding import played_pictures
from streamlod.core.data.video.times import pictures_of
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address, webcam_options
from streamlod.server.ingest.push.message import Codec

_PICTURES = {".jpg": Codec.JPEG, ".jpeg": Codec.JPEG, ".png": Codec.PNG}
_JPEG_QUALITY = 92
SECOND_NS = 1_000_000_000


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
        repeats_ns: nanoseconds after which files and folders start again; None if they do not.
    """

    name: str
    source: Path | Address
    fps: float
    size: tuple[int, int] | None = None
    repeats_ns: int | None = None

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
            if self.repeats_ns is None:
                return
            start_ns = max(start_ns + self.repeats_ns, last + 1)

    def _from_folder(self, start_ns: int) -> Iterator[Taken]:
        assert isinstance(self.source, Path)
        paths = pictures_in(self.source)
        for number, path in zip(picture_numbers(paths), paths, strict=True):
            capture = start_ns + round(number * period_of(self.fps))
            _sleep_until(capture)
            yield Taken(capture, _PICTURES[path.suffix.lower()], path.read_bytes())

    def _from_stream(self, start_ns: int) -> Iterator[Taken]:
        address = self.source
        assert isinstance(address, Address)
        options = webcam_options(self.fps, self.size) if address.scheme == "v4l2" else address.options
        try:
            with closing(av.open(address.url, "r", format=address.format, options=options)) as container:
                stream = video_of(container, address)
                if not address.is_live:
                    rate = SECOND_NS / period_of(self.fps)
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


def video_of(container: av.container.InputContainer, address: Address) -> av.video.stream.VideoStream:
    """The video of an opened source; InputError where it has none."""
    stream = pictures_of(container)
    if stream is None:
        raise InputError(address.url, "holds no pictures, only other streams")
    return stream


def pictures_in(folder: Path) -> list[Path]:
    """The pictures in a folder, in the order of their numbers."""
    return files_in(folder, tuple(_PICTURES))


def picture_numbers(paths: Sequence[Path]) -> tuple[int, ...]:
    """How many periods after the first each picture of a folder was taken, by its number: one may be missing."""
    return instant_numbers([path.stem for path in paths])


def _jpeg(frame: av.VideoFrame) -> bytes:
    ok, data = cv2.imencode(".jpg", upright(frame, "bgr24"), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    assert ok
    return data.tobytes()


def _sleep_until(capture_ns: int) -> None:
    time.sleep(max(0.0, (capture_ns - time.time_ns()) / 1e9))
