"""Opens a source for reading, whatever kind it is."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable, Iterator

import av
import av.container

from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import SILENCE_SECONDS, Address, webcam_options


def open_source(
    address: Address,
    fps: float,
    size: tuple[int, int] | None,
    stack: contextlib.ExitStack,
    interruptible: Callable[[Callable[[], None]], None] = lambda _: None,
) -> av.container.InputContainer:
    """A container that reads from an address.

    Args:
        fps, size: asked of webcams; (width, height), or None for their default.
        stack: closes it.
        interruptible: given what ends opening and reading from another thread, where that can be done.

    Raises:
        av.FFmpegError, OSError: it cannot be opened.
        InputError: a program for it is not installed.
    """
    if address.scheme == "srt":
        pipe = stack.enter_context(_srt_pipe(address.url))
        interruptible(pipe.kill)
        assert pipe.stdout is not None
        container = av.open(pipe.stdout, "r", format=address.format, options=address.options)
        return stack.enter_context(contextlib.closing(container))
    options = webcam_options(fps, size) if address.scheme == "v4l2" else address.options
    timeout = (address.open_seconds, SILENCE_SECONDS) if address.is_live else None
    container = av.open(address.url, "r", format=address.format, options=options, timeout=timeout)
    return stack.enter_context(contextlib.closing(container))


@contextlib.contextmanager
def _srt_pipe(url: str) -> Iterator[subprocess.Popen[bytes]]:
    """FFmpeg reads SRT, which PyAV's library can't, and hands MPEG-TS on."""
    command = ["ffmpeg", "-nostdin", "-loglevel", "error", "-fflags", "nobuffer", "-probesize", "200000",
               "-analyzeduration", "500000", "-i", url, "-map", "0:v:0?", "-map", "0:a:0?", "-c", "copy",
               "-muxdelay", "0", "-flush_packets", "1", "-f", "mpegts", "pipe:1"]  # fmt: skip
    try:
        # unbuffered: filling a buffer would take seconds of a small stream
        pipe = subprocess.Popen(command, bufsize=0, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
    except FileNotFoundError as error:
        raise InputError(url, "SRT is read by the command ffmpeg, which is not installed") from error
    with pipe:
        try:
            yield pipe
        finally:
            pipe.kill()
