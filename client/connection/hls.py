"""HLS playlists of packets, from a server, a cache or a folder: what is there now, or as it comes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Self
from urllib.parse import urljoin, urlsplit

import httpx

from streamlod.codec.container import SlodWriter
from streamlod.codec.mp4.playlist import Playlist, PlaylistPart, read_playlist
from streamlod.codec.mp4.reader import Mp4Reader
from streamlod.codec.packet.info import PacketInfo, peek
from streamlod.codec.sound.beside import sound_beside
from streamlod.codec.sound.packets import OpusPacket, OpusSettings, write_packets
from streamlod.core.data.names import counted
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.web_address import address_parts

MAX_PLAYLIST_BYTES, MAX_BEGINNING_BYTES, MAX_SEGMENT_BYTES = 16 << 20, 1 << 20, 1 << 30
_SECONDS = 30.0  # of waiting for an answer
_MIN_PAUSE, _MAX_PAUSE = 0.5, 5.0  # between two looks at a playlist that grows


@dataclass(frozen=True, slots=True)
class _Opened:
    """A segment that was read."""

    packets: tuple[bytes, ...]
    settings: OpusSettings | None
    sound: tuple[OpusPacket, ...]


def is_playlist(source: str) -> bool:
    """Whether the name or address is one of a playlist; InputError for an address that none can have."""
    return address_parts("the source", source).path.lower().endswith(".m3u8")


def hls_packets(address: str, token: str | None = None) -> Iterator[bytes]:
    """The packets of a stream as they come, from its newest keyframe until it ends.

    Args:
        address: of the playlist, or its path on this machine.
        token: bearer token, sent to the playlist's own host alone.

    Raises:
        InputError: playlist or segments cannot be fetched or read.
    """
    with _Source(address, token) as source:
        done, parts_done, newest = -1, set[str](), None
        while True:
            playlist = source.playlist()
            if done < 0:
                done = playlist.first + len(playlist.segments) - (1 if playlist.parts else 2)
            for number, segment in enumerate(playlist.segments, playlist.first):
                if number > done:
                    for packet in _later(source.segment(playlist, segment).packets, newest):
                        newest = peek(packet)
                        yield packet
                    done, parts_done = number, set()
            for part in playlist.parts:
                if part.address not in parts_done:
                    parts_done.add(part.address)
                    for packet in source.segment(playlist, part).packets:
                        newest = peek(packet)
                        yield packet
            if playlist.is_complete:
                return
            pause = min((part.seconds for part in playlist.parts), default=playlist.longest) / 2
            time.sleep(min(max(pause, _MIN_PAUSE), _MAX_PAUSE))


def save_hls(address: str, out: Path, token: str | None = None) -> str:
    """Write what a playlist names now as a `.slod` file, with its sound beside it; of several encoder runs the last.

    Returns one line that says what was written.

    Raises:
        InputError: playlist or segments cannot be fetched or read, or the file cannot be written.
    """
    with _Source(address, token) as source, SlodWriter(out) as slod:
        playlist = source.playlist()
        wanted = _last_run([*playlist.segments, *playlist.parts])
        if not wanted:
            raise InputError(address, "names no segment yet; try again later")
        count, settings, sound = 0, None, list[OpusPacket]()
        for part in wanted:
            opened = source.segment(playlist, part)
            for packet in opened.packets:
                slod.append(packet)
                count += 1
            settings, sound = settings or opened.settings, [*sound, *opened.sound]
    heard = settings is not None and bool(sound)
    if settings is not None and sound:
        write_packets(sound_beside(out), settings, sound)
    return f"{out}: {counted(count, 'packet')} of {counted(len(wanted), 'segment')}{', with sound' if heard else ''}"


def _last_run(parts: list[PlaylistPart]) -> list[PlaylistPart]:
    starts = [number for number, part in enumerate(parts) if part.is_run_start]
    return parts[starts[-1] :] if starts else parts


def _later(packets: Iterable[bytes], newest: PacketInfo | None) -> Iterator[bytes]:
    """Packets that were not among the parts of the same group."""
    for packet in packets:
        info = peek(packet)
        if newest is None or info.identifier != newest.identifier or info.to_version > newest.to_version:
            yield packet


class _Source:
    """Where a playlist and its segments are fetched."""

    def __init__(self, address: str, token: str | None) -> None:
        self._address = address
        self._is_remote = urlsplit(address).scheme in ("http", "https")
        self._token = token if self._is_remote else None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        self._folder = Path(self._open.enter_context(TemporaryDirectory(prefix="streamlod-hls-")))
        self._http = self._open.enter_context(httpx.Client(timeout=_SECONDS, follow_redirects=True))
        self._beginnings: dict[str, bytes] = {}
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def playlist(self) -> Playlist:
        """The playlist as it is now."""
        data = self._bytes(self._address, MAX_PLAYLIST_BYTES)
        try:
            return read_playlist(data.decode(), self._address)
        except UnicodeDecodeError as error:
            raise InputError(self._address, "is no HLS playlist") from error

    def segment(self, playlist: Playlist, part: PlaylistPart) -> _Opened:
        """The packets and sound of a segment of a playlist."""
        path = self._folder / "segment.mp4"
        if playlist.beginning not in self._beginnings:
            place = self._place(playlist.beginning)
            self._beginnings = {playlist.beginning: self._bytes(place, MAX_BEGINNING_BYTES)}
        place = self._place(part.address)
        with path.open("wb") as file:
            file.write(self._beginnings[playlist.beginning])
            self._copy(place, file, MAX_SEGMENT_BYTES)
        try:
            with Mp4Reader(path) as reader:
                if not reader.is_whole:
                    raise InputError(place, "is cut short")
                return _Opened(tuple(reader.packets()), reader.sound, tuple(reader.sound_packets()))
        except BitstreamError as error:
            raise InputError(place, f"cannot be read: {error}") from error

    def _place(self, address: str) -> str:
        """Where a relative address of the playlist leads."""
        if self._is_remote:
            place = urljoin(self._address, address)
            if urlsplit(place).scheme not in ("http", "https"):
                raise InputError(self._address, f"names {address:.80}, which is no address of the web")
            return place
        folder = Path(self._address).resolve().parent
        path = (folder / address).resolve()
        if not path.is_relative_to(folder):
            raise InputError(self._address, f"names {address:.80}, which lies outside its folder")
        return str(path)

    def _bytes(self, place: str, most: int) -> bytes:
        path = self._folder / "whole"
        with path.open("wb") as file:
            self._copy(place, file, most)
        return path.read_bytes()

    def _copy(self, place: str, out: BinaryIO, most: int) -> None:
        size = 0
        try:
            with self._chunks(place) as chunks:
                for chunk in chunks:
                    size += len(chunk)
                    if size > most:
                        raise InputError(place, f"is longer than {most} bytes")
                    out.write(chunk)
        except (OSError, httpx.HTTPError, httpx.InvalidURL) as error:
            raise InputError(place, f"cannot be fetched ({error})") from error

    @contextmanager
    def _chunks(self, place: str) -> Iterator[Iterator[bytes]]:
        if not self._is_remote:
            with Path(place).open("rb") as file:
                yield iter(lambda: file.read(1 << 20), b"")
            return
        own = urlsplit(place)[:2] == urlsplit(self._address)[:2]
        headers = {"Authorization": f"Bearer {self._token}"} if self._token and own else {}
        with self._http.stream("GET", place, headers=headers) as answer:
            if not answer.is_success:
                raise InputError(place, f"is answered by {answer.status_code} {answer.reason_phrase}".rstrip())
            yield answer.iter_bytes()
