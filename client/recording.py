"""Recorded files, `.slod` or MP4, decoded frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from streamlod.codec.container import Entry
from streamlod.codec.container.packet_file import PacketFile
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.opening import open_packets
from streamlod.codec.packet.packet import PacketKind
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.anchors import Scene


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """A decoded instant of a file.

    Attributes:
        scene: the state.
        time_ns: presentation time.
        key_bytes: size of the key packets that led here from the frame before; 0 where there were none.
        predicted_bytes: size of the other packets that led here.
    """

    scene: Scene
    time_ns: int
    key_bytes: int
    predicted_bytes: int


def require_whole(path: Path, reader: PacketFile) -> None:
    """Raise InputError for a file that is incomplete, because it was cut or is still being written."""
    if not reader.is_whole:
        complete = len(reader.entries)
        raise InputError(path, f"is cut short: {complete} complete packets and no end; copy or record it again")


def decode_frames(path: Path) -> Iterator[RecordedFrame]:
    """All frames of the file, in order, decoded from its bytes alone.

    Packets that are refused as `version_mismatch` are passed over (FORMAT.md section 15). Where several versions show
    one instant (previews of a live recording), the last one is used.

    Raises:
        InputError: the file cannot be opened, is cut or damaged; names it.
    """
    with _opened(path) as reader:
        yield from _decode(reader)


@contextmanager
def _opened(path: Path) -> Iterator[PacketFile]:
    """The packets of a whole file; InputError that names it where it cannot be opened, is cut or damaged."""
    try:
        with open_packets(path) as reader:
            require_whole(path, reader)
            yield reader
    except BitstreamError as error:
        raise InputError(path, f"is damaged: {error}") from error


def _decode(reader: PacketFile) -> Iterator[RecordedFrame]:
    decoder = SceneDecoder()
    for time_ns, numbers in _instants(reader.entries):
        key_bytes = predicted_bytes = 0
        for number in numbers:
            entry, before = reader.entries[number], decoder.scene
            try:
                decoder.push(reader.read(number))
            except BitstreamError as error:
                if error.code == "version_mismatch":  # a packet to seek with
                    continue
                raise
            if entry.kind is not PacketKind.KEY:
                predicted_bytes += entry.size_bytes
            elif before is None or entry.to_version > before.version:
                key_bytes, predicted_bytes = entry.size_bytes, 0  # an early keyframe is replaced by a better one
            else:
                key_bytes += entry.size_bytes
        if decoder.scene is not None and key_bytes + predicted_bytes:
            yield RecordedFrame(decoder.scene, time_ns, key_bytes, predicted_bytes)


def _instants(entries: Sequence[Entry]) -> Iterator[tuple[int, Sequence[int]]]:
    """Each instant's time, and the numbers of its packets.

    A packet of an earlier time under the same keyframe belongs to the instant that it stands in: it brings a level
    that lags behind the others.
    """
    numbers: list[int] = []
    for number, entry in enumerate(entries):
        if numbers:
            now = entries[numbers[0]]
            if entry.time_ns > now.time_ns or (entry.time_ns < now.time_ns and entry.keyframe != now.keyframe):
                yield now.time_ns, numbers
                numbers = []
        numbers.append(number)
    if numbers:
        yield entries[numbers[0]].time_ns, numbers


def decode_version(path: Path, version: int) -> Scene:
    """The state at `version`, from as few bytes as possible.

    Raises:
        InputError: the file is cut or damaged, or does not reach the version.
    """
    decoder = SceneDecoder()
    with _opened(path) as reader:
        for number in reader.plan(version):
            decoder.push(reader.read(number))
    if decoder.scene is None:
        raise InputError(path, "it holds no packet")
    return decoder.scene


def versions(path: Path) -> tuple[int, ...]:
    """The versions that the file holds, ascending."""
    with _opened(path) as reader:
        return tuple(sorted({entry.to_version for entry in reader.entries}))


@dataclass(frozen=True, slots=True)
class RecordingFile:
    """A recorded stream on disk; nothing of it stays open between calls.

    Attributes:
        path: the file.
        versions: numbers of the states that it holds, ascending.
    """

    path: Path
    versions: tuple[int, ...]

    def frames(self) -> Iterator[RecordedFrame]:
        """All frames in order, each decoded when it is asked for.

        Raises:
            InputError: the file is cut or damaged.
        """
        return decode_frames(self.path)

    def scene(self, version: int) -> Scene:
        """The state at one of `versions`, decoded from the keyframe before it.

        Raises:
            InputError: the file is cut or damaged, or does not reach the version.
        """
        return decode_version(self.path, version)


def open_recording(path: Path | str) -> RecordingFile:
    """A `.slod` file, or an MP4 file with packets, for reading.

    Raises:
        InputError: the file cannot be opened, or is cut or damaged.
    """
    return RecordingFile(Path(path), versions(Path(path)))
