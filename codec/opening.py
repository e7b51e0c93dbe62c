"""Files of packets, of whichever kind: `.slod` or MP4."""

from __future__ import annotations

from pathlib import Path

from streamlod.codec.container import SlodReader
from streamlod.codec.container.packet_file import PacketFile
from streamlod.codec.mp4.reader import Mp4Reader, is_mp4
from streamlod.core.errors import InputError


def open_packets(path: Path) -> PacketFile:
    """The file for reading, by how it begins; to be closed.

    Raises:
        InputError: it cannot be opened.
        BitstreamError: it is of neither kind, or of another version.
    """
    if path.is_fifo():
        raise InputError(path, "is a pipe, which cannot be read at any place; write it to a file first")
    return Mp4Reader(path) if is_mp4(path) else SlodReader(path)
