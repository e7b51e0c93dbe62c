"""The video of one camera while it is recorded: its pictures with their capture times, as fast as they come."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av

from streamlod.core.camera import Camera
from streamlod.core.data.video.file import ONE_CLOCK
from streamlod.core.errors import InputError
from streamlod.server.ingest.sync.picture import Picture

_BUFFERED = 32  # pictures of a camera that may wait to be written
_TICKS = 90_000  # a second, of the files' times
# Each group of pictures is whole on disk before the next one begins: what was filmed outlives this process. The list
# of the file waits for the first picture, whose time it has.
_FILE = {"movflags": "hybrid_fragmented+delay_moov", "flush_packets": "1"}
_ENCODER = {"preset": "ultrafast", "tune": "zerolatency", "crf": "17", "g": "30"}  # as fast as the cameras film


class VideoWriter(threading.Thread):
    """Writes one camera's video on a thread of its own.

    Args:
        file: MP4.
        camera: of which pictures are written.
        fps: of the rig.
        begin_ns: capture time at which the file begins.
        seconds: that it lasts at most.
        failed: called once it cannot be written any more.

    Attributes:
        count: pictures that were written.
        left_out: pictures that were not, because this machine was too slow.
    """

    def __init__(
        self, file: Path, camera: Camera, fps: float, begin_ns: int, seconds: float, failed: Callable[[], None]
    ) -> None:
        super().__init__(daemon=True, name=f"record {camera.name}")
        self._file, self._size, self._fps = file, (camera.width, camera.height), fps
        self._begin_ns, self._ticks = begin_ns, round(seconds * _TICKS)
        self._waiting: queue.Queue[Picture | None] = queue.Queue(_BUFFERED)
        self._failure: InputError | None = None
        self._failed = failed
        self.count = self.left_out = 0

    def take(self, picture: Picture) -> None:
        """Have a picture written, unless too many wait; never waits itself."""
        try:
            self._waiting.put_nowait(picture)
        except queue.Full:
            self.left_out += 1

    def end(self) -> InputError | None:
        """Wait until all is written; the fault where something could not be."""
        self._waiting.put(None)
        self.join()
        return self._failure

    def run(self) -> None:
        try:
            self._write_all()
        except (av.FFmpegError, OSError) as error:
            self._failure = InputError(self._file, f"cannot be written ({error.strerror or error})")
            self._failed()
            while self._waiting.get() is not None:  # nobody shall wait for room
                pass

    def _write_all(self) -> None:
        even = self._size[0] % 2 == 0 and self._size[1] % 2 == 0
        with av.open(str(self._file), "w", format="mp4", options=_FILE) as container:
            container.metadata["comment"] = ONE_CLOCK
            stream = container.add_stream("libx264", rate=Fraction(self._fps).limit_denominator(1001), options=_ENCODER)
            stream.width, stream.height = self._size
            stream.pix_fmt = "yuv420p" if even else "yuv444p"
            stream.codec_context.time_base = Fraction(1, _TICKS)
            last = -1
            while (picture := self._waiting.get()) is not None:
                ticks = round((picture.capture_ns - self._begin_ns) * _TICKS / 1e9)
                if not last < ticks < self._ticks:
                    continue
                try:
                    frame = av.VideoFrame.from_ndarray(picture.load(), format="rgb24")
                except InputError:  # a damaged picture
                    continue
                frame.pts, frame.time_base = ticks, Fraction(1, _TICKS)
                container.mux(stream.encode(frame))
                last, self.count = ticks, self.count + 1
            if self.count:
                container.mux(stream.encode())
