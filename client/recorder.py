"""Writes pictures to PNG files or an MP4, which appear under their names when they are complete."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path
from shutil import disk_usage
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from streamlod.core.arrays import UInt8, check_array
from streamlod.core.errors import InputError
from streamlod.core.files import put_in_place, temporary_beside, write_bytes

_OTHERS = (".avi", ".gif", ".jpeg", ".jpg", ".m4v", ".mkv", ".mov", ".png", ".webm", ".webp")
_FINEST = 1001  # largest denominator of a film's rate
_QUALITY = "18"  # x264's constant rate factor: visually near lossless
_LEFT_BYTES = 1 << 20  # of the disk, in which a film is ended, besides what follows
_HELD_PICTURES = 64  # or fewer, that the encoder has taken and not given out
_INDEX_BYTES = 64  # of a picture


class Recorder(Protocol):
    """Records pictures in order; leaving the context completes the recording, or discards it on an error."""

    count: int

    def add(self, picture: UInt8) -> None:
        """Append a picture [H,W,3] RGB."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def open_recorder(out: Path | str, fps: float) -> Recorder:
    """An MP4 file where `out` ends in .mp4, otherwise a folder of numbered PNGs.

    Raises:
        InputError: the place cannot be written to, or is called like a film or picture of another kind, or `fps` is no
            rate.
    """
    out = Path(out)
    if not 1 / _FINEST <= fps < math.inf:
        raise InputError("fps", f"must be a number above 0, not {fps:g}")
    if out.suffix.lower() in _OTHERS and not out.is_dir():
        raise InputError(out, "is neither an .mp4 file nor a folder of pictures; name one of these")
    try:
        (out.parent if is_film(out) else out).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})") from error
    return _Mp4(out, fps) if is_film(out) else _PngFolder(out)


def is_film(out: Path) -> bool:
    """Whether `open_recorder` makes a film of this path, and no folder."""
    return out.suffix.lower() == ".mp4"


def write_png(path: Path | str, picture: UInt8) -> None:
    """One picture [H,W,3] RGB, 8 bits a colour, as a whole file.

    Raises:
        TypeError, ValueError: another type, such as float, or shape.
        InputError: the file cannot be written, or the picture has no pixel.
    """
    import cv2

    check_array("picture", picture, (None, None, 3), np.uint8)
    if not picture.size:
        raise InputError(path, "a picture needs a pixel a side or more")
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    if not done:
        raise InputError(path, "the picture could not be encoded as PNG")
    write_bytes(Path(path), data.tobytes())


class _PngFolder(AbstractContextManager["_PngFolder"]):
    """00000.png, 00001.png, ...; each is complete once it has its name."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.count = 0

    def add(self, picture: UInt8) -> None:
        write_png(self._folder / f"{self.count:05d}.png", picture)
        self.count += 1

    def __exit__(self, *_: object) -> None:
        return None


class _Mp4(AbstractContextManager["_Mp4"]):
    """H.264 in MP4, 4:2:0; odd sizes lose their last row or column."""

    def __init__(self, path: Path, fps: float) -> None:
        self._path, self._rate = path, Fraction(fps).limit_denominator(_FINEST)
        self._temporary = temporary_beside(path)
        self._container: Any = None
        self._stream: Any = None
        self._largest = 0  # bytes of a picture so far
        self.count = 0

    def add(self, picture: UInt8) -> None:
        import av

        check_array("picture", picture, (None, None, 3), np.uint8)
        height, width = picture.shape[0] & ~1, picture.shape[1] & ~1
        if not height or not width:
            raise InputError(
                self._path, "a film needs two pixels a side or more; a folder of pictures takes smaller ones"
            )
        if self._container is None:
            self._container = av.open(str(self._temporary), "w", format="mp4", options={"movflags": "faststart"})
            self._stream = self._container.add_stream("libx264", rate=self._rate, options={"crf": _QUALITY})
            self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        if (height, width) != (self._stream.height, self._stream.width):
            raise InputError(self._path, "pictures changed their size; record each size into its own file")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
        self._check_room()
        try:
            packets = self._stream.encode(frame)
            self._largest = max([self._largest, *(packet.size for packet in packets)])
            self._container.mux(packets)
        except (av.FFmpegError, OSError) as error:
            raise self._unwritten(error) from error
        self.count += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import av

        if self._container is None:
            return
        try:
            try:
                if kind is None:
                    self._container.mux(self._stream.encode(None))
            finally:
                self._container.close()
            if kind is None:
                put_in_place(self._temporary, self._path)
        except (av.FFmpegError, OSError) as fault:
            if kind is None:  # else what came first is told
                raise self._unwritten(fault) from fault
        finally:
            self._temporary.unlink(missing_ok=True)

    def _check_room(self) -> None:
        """Take no more pictures while the film can still be ended: what cannot be written later is lost as a whole."""
        needed = _LEFT_BYTES + _HELD_PICTURES * self._largest + _INDEX_BYTES * self.count
        if self.count and disk_usage(self._path.parent).free < needed:
            raise InputError(self._path, "cannot be written any more (the disk is full); make room")

    def _unwritten(self, error: Exception) -> InputError:
        return InputError(self._path, f"cannot be written ({getattr(error, 'strerror', None) or error})")
