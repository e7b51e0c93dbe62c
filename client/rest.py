"""The REST interface of a server from Python: streams, viewers, recordings and events (docs/protocol.md, section 3)."""

from __future__ import annotations

import ssl
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import httpx

from streamlod.client.rest_answers import (
    FeedEvent,
    RecordingInfo,
    StreamInfo,
    ViewerInfo,
    items_in,
    not_ours,
    object_in,
    read,
)
from streamlod.codec.sound.beside import MEDIA_TYPE
from streamlod.core.errors import InputError, RequestRefused
from streamlod.core.files import written_whole

_SECONDS = 30.0
_MAX_ITEMS = 200  # of a page
_JSON, _FILE, _EVENTS = "application/json", "application/vnd.streamlod", "text/event-stream"
_MAX_SOUND_BYTES = 1 << 30


class ServerClient:
    """REST of one server.

    All methods raise RequestRefused where the server refuses, and InputError where it cannot be reached or is another
    program than streamlod.

    Args:
        address: such as ``https://stage.example``.
        token: bearer token, where the server wants one.
        ca: certificates (PEM) to trust instead of the system's.
    """

    def __init__(self, address: str, token: str | None = None, ca: Path | str | None = None) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        try:
            verify = ssl.create_default_context(cafile=ca)
            self._http = httpx.Client(base_url=address, headers=headers, timeout=_SECONDS, verify=verify)
        except (httpx.InvalidURL, OSError) as error:
            raise InputError(ca or address, f"cannot be used ({error})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def server(self) -> dict[str, Any]:
        """Version, limits and capabilities."""
        found = self._json("/v1/server")
        if "protocol_versions" not in found:
            raise not_ours("does not say which versions of the protocol it knows")
        return found

    def streams(self) -> tuple[StreamInfo, ...]:
        """All streams that the token may read."""
        return tuple(read(StreamInfo, item) for item in self._pages("/v1/streams", {}))

    def stream(self, name: str) -> StreamInfo:
        """One stream."""
        return self._stream("GET", _path(name))

    def definition(self, name: str) -> dict[str, Any]:
        """The options that a stream is made from."""
        return self._json(f"{_path(name)}/definition")

    def create(self, name: str, options: Mapping[str, Any]) -> StreamInfo:
        """A new stream; `options` as in the body of ``POST /v1/streams``."""
        return self._stream("POST", "/v1/streams", body={**options, "id": name})

    def change(self, name: str, options: Mapping[str, Any], etag: str | None = None) -> StreamInfo:
        """Change what a stream is made from; with `etag`, only if the stream's ETag is still that."""
        return self._stream("PATCH", _path(name), body=dict(options), etag=etag)

    def start(self, name: str) -> StreamInfo:
        """Start a stream."""
        return self._stream("POST", f"{_path(name)}/start")

    def stop(self, name: str) -> StreamInfo:
        """Stop a stream."""
        return self._stream("POST", f"{_path(name)}/stop")

    def delete(self, name: str, *, erase: bool = False, etag: str | None = None) -> None:
        """Delete a stream, and what was recorded of it if wanted."""
        self._delete(_path(name), {"erase": erase}, etag=etag)

    def viewers(self, name: str) -> tuple[ViewerInfo, ...]:
        """Who watches a stream."""
        return tuple(read(ViewerInfo, item) for item in items_in(self._json(f"{_path(name)}/viewers")))

    def disconnect(self, name: str, viewer: str) -> None:
        """Close a viewer's connection."""
        self._delete(f"{_path(name)}/viewers/{quote(viewer, safe='')}")

    def recordings(self, begin: datetime | None = None, end: datetime | None = None) -> tuple[RecordingInfo, ...]:
        """The recordings between two times, of every stream that the token may read."""
        return tuple(read(RecordingInfo, item) for item in self._pages("/v1/recordings", _times(begin, end)))

    def download(
        self,
        name: str,
        path: Path | str,
        begin: datetime | None = None,
        end: datetime | None = None,
        epoch: int | None = None,
    ) -> int:
        """Write a recording, or what of it lies between two times, to a `.slod` file; returns its length in bytes."""
        params = _times(begin, end) | ({} if epoch is None else {"epoch": epoch})
        return self._save(f"/v1/recordings/{quote(name, safe='')}/bitstream", _FILE, params, Path(path))

    def download_sound(self, name: str, path: Path | str, from_ns: int = 0, to_ns: int | None = None) -> int:
        """Write the sound of a stream to an Ogg Opus file; returns its length in bytes.

        Args:
            from_ns: time from which live sound is wanted, on the clock of the packets.
            to_ns: time up to which it is wanted; None for all that there is.
        """
        times = {"from_ns": from_ns, "to_ns": to_ns}
        given = {name: value for name, value in times.items() if value}
        return self._save(f"/v1/streams/{quote(name, safe='')}/sound", MEDIA_TYPE, given, Path(path), _MAX_SOUND_BYTES)

    def _save(self, place: str, kind: str, params: dict[str, Any], path: Path, most: int | None = None) -> int:
        """Write what is at `place` to a file, whole or not at all; returns its length in bytes, at most `most`."""
        size = 0
        try:
            with (
                written_whole(path) as temporary,
                self._open("GET", place, kind, params) as answer,
                temporary.open("wb") as file,
            ):
                for chunk in answer.iter_bytes():
                    size += file.write(chunk)
                    if most is not None and size > most:
                        raise InputError(self._http.base_url, f"sends more than {most} bytes of sound")
        except httpx.HTTPError as error:
            raise InputError(self._http.base_url, f"the download broke off ({error})") from error
        except OSError as error:
            raise InputError(path, f"cannot be written ({error.strerror})") from error
        return size

    def erase(self, name: str, begin: datetime | None = None, end: datetime | None = None) -> None:
        """Delete what was recorded of a stream, or of it what lies between two times."""
        self._delete(f"/v1/recordings/{quote(name, safe='')}", _times(begin, end))

    def events(self, name: str | None = None, last_id: str | None = None) -> Iterator[FeedEvent]:
        """Events after `last_id`, then as they happen; ends when the feed is closed or the connection breaks."""
        headers = {} if last_id is None else {"Last-Event-ID": last_id}
        params = {} if name is None else {"stream": name}
        with self._open("GET", "/v1/events", _EVENTS, params, headers=headers, timeout=None) as answer:
            try:
                for line in answer.iter_lines():
                    if line.startswith("data: "):
                        yield read(FeedEvent, object_in(line.removeprefix("data: ")))
            except httpx.HTTPError:
                return

    def _stream(self, method: str, path: str, **options: Any) -> StreamInfo:
        answer = self._send(method, path, _JSON, **options)
        return read(StreamInfo, object_in(answer.content) | {"etag": answer.headers.get("etag")})

    def _pages(self, path: str, params: dict[str, Any]) -> Iterator[Any]:
        cursor = None
        while True:
            extra = {"limit": _MAX_ITEMS} | ({} if cursor is None else {"cursor": cursor})
            page = self._json(path, params | extra)
            yield from items_in(page)
            cursor = page.get("next_cursor")
            if cursor is None:
                return

    def _json(self, path: str, params: dict[str, Any] | None = None) -> dict[str, Any]:
        return object_in(self._send("GET", path, _JSON, params).content)

    def _delete(self, path: str, params: dict[str, Any] | None = None, etag: str | None = None) -> None:
        self._send("DELETE", path, None, params, etag=etag)

    def _send(
        self,
        method: str,
        path: str,
        kind: str | None,
        params: dict[str, Any] | None = None,
        *,
        body: Any = None,
        etag: str | None = None,
    ) -> httpx.Response:
        headers = {} if etag is None else {"If-Match": etag}
        with self._open(method, path, kind, params, headers=headers, json=body) as answer:
            try:
                answer.read()
            except httpx.HTTPError as error:
                raise InputError(self._http.base_url, f"the answer broke off ({error})") from error
            return answer

    @contextmanager
    def _open(
        self, method: str, path: str, kind: str | None, params: dict[str, Any] | None = None, **options: Any
    ) -> Iterator[httpx.Response]:
        """An answer whose body is not read yet.

        Args:
            kind: media type that the answer must have; None where it must be empty.
        """
        try:
            answer = self._http.send(self._http.build_request(method, path, params=params, **options), stream=True)
        except httpx.HTTPError as error:
            raise InputError(self._http.base_url, f"cannot be reached ({error}); is the server running?") from error
        with closing(answer):
            if not answer.is_success:
                raise RequestRefused(answer.status_code, _detail(answer))
            found = answer.headers.get("content-type", "").partition(";")[0]
            if (answer.status_code != httpx.codes.NO_CONTENT) if kind is None else (found != kind):
                raise not_ours(f"answers {answer.status_code} with {found or 'nothing'}")
            yield answer


def _detail(answer: httpx.Response) -> str:
    """The `detail` of a problem document (RFC 9457), or the reason phrase where there is none."""
    try:
        answer.read()
        return str(answer.json()["detail"])
    except (httpx.HTTPError, ValueError, KeyError, TypeError):
        return answer.reason_phrase or "no reason given"


def _path(name: str) -> str:
    return f"/v1/streams/{quote(name, safe='')}"


def _times(begin: datetime | None, end: datetime | None) -> dict[str, Any]:
    given = {"from": begin, "to": end}
    return {name: time.astimezone(UTC).isoformat() for name, time in given.items() if time is not None}
