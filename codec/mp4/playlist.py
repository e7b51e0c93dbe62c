"""HLS playlists (RFC 8216, and its second edition for parts) of segments that hold a group of pictures each."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from streamlod.core.errors import InputError

MEDIA_TYPE, SEGMENT_TYPE = "application/vnd.apple.mpegurl", "video/mp4"
MAX_LINES, MAX_ADDRESS = 200_000, 4096
_HOLD_BACK_PARTS = 3  # that a player stays behind, at least (second edition of RFC 8216, section 4.4.3.8)
_ATTRIBUTE = re.compile(r'([A-Z0-9-]+)=("[^"]*"|[^",]*)')


@dataclass(frozen=True, slots=True)
class PlaylistPart:
    """A segment, or a part of the newest one.

    Attributes:
        address: relative to the playlist.
        seconds: how long it lasts.
        begins_anew: whether it can be decoded without what comes before.
        is_run_start: whether another encoder run begins with it, with times of its own.
        begun_ns: Unix time at which it was recorded, where that is known.
    """

    address: str
    seconds: float
    begins_anew: bool = True
    is_run_start: bool = False
    begun_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Playlist:
    """A media playlist.

    Attributes:
        beginning: address of the initialisation segment.
        segments: whole groups of pictures.
        parts: those of the group that is not whole yet.
        first: number of the first segment; numbers never come back while segments leave at the front.
        runs_before: encoder runs that have left at the front.
        longest: an upper bound on the seconds that a segment lasts.
        is_complete: whether nothing will be added.
    """

    beginning: str
    segments: tuple[PlaylistPart, ...]
    parts: tuple[PlaylistPart, ...] = ()
    first: int = 0
    runs_before: int = 0
    longest: float = 1.0
    is_complete: bool = False


def playlist_text(playlist: Playlist) -> str:
    """The playlist as it is sent."""
    longest = max([playlist.longest, *(segment.seconds for segment in playlist.segments)])
    lines = ["#EXTM3U", "#EXT-X-VERSION:9" if playlist.parts else "#EXT-X-VERSION:6", "#EXT-X-INDEPENDENT-SEGMENTS"]
    lines += [f"#EXT-X-TARGETDURATION:{max(1, math.ceil(longest))}", f"#EXT-X-MEDIA-SEQUENCE:{playlist.first}"]
    if playlist.runs_before:
        lines.append(f"#EXT-X-DISCONTINUITY-SEQUENCE:{playlist.runs_before}")
    if playlist.is_complete and not playlist.first:
        lines.append("#EXT-X-PLAYLIST-TYPE:VOD")
    if playlist.parts:
        target = max(part.seconds for part in playlist.parts)
        lines.append(f"#EXT-X-SERVER-CONTROL:PART-HOLD-BACK={_HOLD_BACK_PARTS * target:.6f}")
        lines.append(f"#EXT-X-PART-INF:PART-TARGET={target:.6f}")
    lines.append(f'#EXT-X-MAP:URI="{playlist.beginning}"')
    for segment in playlist.segments:
        lines += [*_before(segment), f"#EXTINF:{segment.seconds:.6f},", segment.address]
    for part in playlist.parts:
        anew = ",INDEPENDENT=YES" if part.begins_anew else ""
        lines += [*_before(part), f'#EXT-X-PART:DURATION={part.seconds:.6f},URI="{part.address}"{anew}']
    return "\n".join([*lines, *(["#EXT-X-ENDLIST"] if playlist.is_complete else []), ""])


def with_query(text: str, query: str) -> str:
    """The playlist with a query, such as a signature, behind each address: players do not pass on their own."""
    if not query:
        return text
    lines = text.split("\n")
    return "\n".join(
        re.sub(r'URI="([^"]*)"', lambda found: f'URI="{found[1]}?{query}"', line)
        if line.startswith("#") or not line
        else f"{line}?{query}"
        for line in lines
    )


def read_playlist(text: str, name: object) -> Playlist:
    """A playlist that came from outside; tags that are not known here are passed over.

    Raises:
        InputError: no media playlist of our kind; names it `name`.
    """
    lines = text.splitlines()
    if not lines or lines[0].strip() != "#EXTM3U" or len(lines) > MAX_LINES:
        raise InputError(name, "is no HLS playlist")
    found = _Reading(name)
    for line in lines[1:]:
        found.take(line.strip())
    return found.whole()


class _Reading:
    """A playlist that is being read."""

    def __init__(self, name: object) -> None:
        self._name = name
        self._beginning: str | None = None
        self._segments: list[PlaylistPart] = []
        self._parts: list[PlaylistPart] = []
        self._next = PlaylistPart("", 0.0)
        self._known = Playlist("", ())

    def take(self, line: str) -> None:
        """Read one line."""
        if not line.startswith("#"):
            if line:
                self._segments.append(replace(self._next, address=self._address(line)))
                self._next, self._parts = PlaylistPart("", 0.0), []
            return
        tag, _, value = line.partition(":")
        if tag == "#EXTINF":
            self._next = replace(self._next, seconds=self._number(value.split(",")[0]))
        elif tag == "#EXT-X-DISCONTINUITY":
            self._next = replace(self._next, is_run_start=True)
        elif tag == "#EXT-X-MAP":
            self._map(_attributes(value))
        elif tag == "#EXT-X-PART":
            self._part(_attributes(value))
        elif tag == "#EXT-X-MEDIA-SEQUENCE":
            self._known = replace(self._known, first=int(self._number(value)))
        elif tag == "#EXT-X-TARGETDURATION":
            self._known = replace(self._known, longest=self._number(value))
        elif tag == "#EXT-X-ENDLIST":
            self._known = replace(self._known, is_complete=True)
        elif tag in ("#EXT-X-STREAM-INF", "#EXT-X-BYTERANGE", "#EXT-X-KEY"):
            raise InputError(self._name, f"has {tag[1:]}, which is not read here; name a plain media playlist")

    def whole(self) -> Playlist:
        """The playlist, once all lines were read."""
        if self._beginning is None:
            raise InputError(self._name, "names no initialisation segment (EXT-X-MAP), so it is no stream of ours")
        return replace(self._known, beginning=self._beginning, segments=tuple(self._segments), parts=tuple(self._parts))

    def _map(self, attributes: dict[str, str]) -> None:
        address = self._address(attributes.get("URI", ""))
        if self._beginning not in (None, address):
            raise InputError(self._name, "changes its initialisation segment, which is not read here")
        self._beginning = address

    def _part(self, attributes: dict[str, str]) -> None:
        anew = attributes.get("INDEPENDENT") == "YES"
        seconds = self._number(attributes.get("DURATION", ""))
        start = self._next.is_run_start and not self._parts
        self._parts.append(PlaylistPart(self._address(attributes.get("URI", "")), seconds, anew, start))

    def _address(self, text: str) -> str:
        if not 0 < len(text) <= MAX_ADDRESS:
            raise InputError(self._name, f"has an address of {len(text)} characters")
        return text

    def _number(self, text: str) -> float:
        try:
            found = float(text)
        except ValueError as error:
            raise InputError(self._name, f"has {text[:40]!r} in place of a number") from error
        if not 0 <= found < 2**53:
            raise InputError(self._name, f"has the number {text[:40]}, which is out of range")
        return found


def _before(part: PlaylistPart) -> Iterator[str]:
    if part.is_run_start:
        yield "#EXT-X-DISCONTINUITY"
    if part.begun_ns is not None:
        time = datetime.fromtimestamp(part.begun_ns / 1e9, UTC)
        yield f"#EXT-X-PROGRAM-DATE-TIME:{time.isoformat(timespec='milliseconds').replace('+00:00', 'Z')}"


def _attributes(text: str) -> dict[str, str]:
    return {name: value.strip('"') for name, value in _ATTRIBUTE.findall(text)}
