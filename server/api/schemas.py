"""JSON bodies of the REST interface."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from streamlod.core.field_faults import matching
from streamlod.server.auth.links import MAX_LINK_SECONDS
from streamlod.server.ingest.cameras.address import CAMERA_NAME

_STREAM_EXAMPLE: dict[str, Any] = {
    "id": "main", "name": "main", "incarnation": "9f86d081884c7d65", "source": "cameras", "loop": False,
    "sound": None, "state": "live", "detail": "", "epoch": 1, "version": 57, "fps": 30.0, "levels": 5,
    "anchors": 20413, "viewers": 2, "restarts": 0, "recording": "on",
    "progress": {"fraction": 1.0, "loss": 0.03, "text": "first frame"},
    "report": {"version": 57, "total_seconds": 0.8}, "ingest": None, "camera_pictures": ["cam00"],
    "created_at": "2026-11-21T10:00:00Z",
    "live_path": "/v1/streams/main/live",
}  # fmt: skip

_MANIFEST_EXAMPLE: dict[str, Any] = {
    "stream": "main", "incarnation": "9f86d081884c7d65", "state": "live", "epoch": 1, "levels": 5, "fps": 30.0,
    "window": {"oldest": {"epoch": 1, "version": 0}, "newest": {"epoch": 1, "version": 57},
               "newest_time_ns": 1764000061000000000},
    "gops": [{"epoch": 1, "first": 0, "last": 57, "packets": 58, "bytes": 812345, "begun_ns": 1764000000000000000,
              "first_time_ns": 1763999992000000000, "last_time_ns": 1764000061000000000,
              "path": "/v1/streams/main/incarnations/9f86d081884c7d65/gops/1/0"}],
    "edges": ["https://edge1.example"],
}  # fmt: skip


class PositionBody(BaseModel):
    """A place in a stream."""

    epoch: int = Field(description="counts encoder runs", examples=[1])
    version: int = Field(description="number of the state in its epoch", examples=[57])


class WindowBody(BaseModel):
    """The positions that a viewer can seek."""

    oldest: PositionBody
    newest: PositionBody
    newest_time_ns: int = Field(description="when the newest was filmed, as its packet says")


class SoundBody(BaseModel):
    """The sound of a stream, which is at `sound`."""

    begin_ns: int = Field(description="time of its first sample, on the clock of the packets' times")
    channels: int
    live: bool = Field(default=False, description="whether it comes as it is heard, by the live websocket")
    camera: str | None = Field(default=None, description="the camera at which its microphone stands; null: unknown")


class StreamBody(BaseModel):
    """A stream's state."""

    model_config = ConfigDict(json_schema_extra={"examples": [_STREAM_EXAMPLE]})

    id: str
    name: str
    incarnation: str = Field(description="names this stream's packets for good; one made anew under its id has another")
    source: Literal["cameras", "data", "recording"] = Field(
        description="live cameras, pictures taken earlier that are trained now, or a recorded bitstream"
    )
    loop: bool = Field(description="whether a recording begins again at its end")
    sound: SoundBody | None = Field(description="the sound of a played recording or of live cameras; null without")
    state: Literal["idle", "starting", "live", "degraded", "ended", "failed"]
    detail: str = Field(description="why, where the state needs an explanation")
    epoch: int | None
    version: int | None = Field(description="newest version; null before the first picture")
    fps: float | None
    levels: int | None
    anchors: int | None
    viewers: int
    restarts: int = Field(description="worker restarts since the start")
    recording: str = Field(description="off, on, or what stopped it")
    progress: dict[str, Any] | None = Field(description="of the first frame's training")
    report: dict[str, Any] | None = Field(description="figures of the newest frame's training")
    ingest: dict[str, Any] | None = Field(
        description="figures of live cameras (docs/ingest.md); null for other sources"
    )
    camera_pictures: list[str] = Field(
        description="cameras of which `cameras/{name}.jpg` is a picture, with the setting `camera_pictures`"
    )
    created_at: datetime
    live_path: str


class StreamList(BaseModel):
    """A page of streams."""

    items: list[StreamBody]
    next_cursor: str | None = Field(description="pass it as `cursor` for the next page; null on the last")


class GroupBody(BaseModel):
    """A group of pictures."""

    epoch: int
    first: int = Field(description="version of its keyframe")
    last: int = Field(description="newest version")
    packets: int
    bytes: int
    begun_ns: int | None = Field(description="Unix time at which its keyframe was recorded, where it is recorded")
    first_time_ns: int | None = Field(description="when its keyframe was filmed, as its packet says")
    last_time_ns: int | None = Field(description="when its newest version was filmed, as its packet says")
    path: str


class Manifest(BaseModel):
    """The window and its groups of pictures."""

    model_config = ConfigDict(json_schema_extra={"examples": [_MANIFEST_EXAMPLE]})

    stream: str
    incarnation: str
    state: str
    epoch: int | None
    window: WindowBody | None
    levels: int | None
    fps: float | None
    gops: list[GroupBody]
    edges: list[str] = Field(description="addresses of servers at which the same stream can be watched")


_LINK_PATH = rf"^(bitstream|sound|hls/index\.m3u8|(gops|packets)/[0-9]{{1,10}}/[0-9]{{1,10}}|ingest/{CAMERA_NAME})?$"


_LINK_WORDS = "bitstream, sound, hls/index.m3u8, gops/EPOCH/VERSION, packets/EPOCH/VERSION or ingest/CAMERA, or nothing"


class NewLink(BaseModel):
    """A download, or a phone that films as one camera, to make an address for."""

    model_config = ConfigDict(
        extra="forbid", strict=True, json_schema_extra={"examples": [{"path": "bitstream", "seconds": 3600}]}
    )

    path: Annotated[str, BeforeValidator(matching(_LINK_PATH, _LINK_WORDS))] = Field(
        default="",
        pattern=_LINK_PATH,
        description="download below the stream, all of them without; or `ingest/CAMERA` (right `publish`)",
    )
    seconds: int = Field(default=3600, ge=1, le=MAX_LINK_SECONDS, description="how long the address is good")


class Link(BaseModel):
    """An address that needs no token."""

    url: str = Field(
        description="with its signature", examples=["/v1/streams/main/bitstream?expires=...&signature=..."]
    )
    query: str = Field(description="the signature alone, for any path that it covers")
    expires_at: datetime


class ViewerBody(BaseModel):
    """A viewer of a stream."""

    id: str
    address: str = Field(description="where it connects from")
    client: str = Field(description="what it calls itself")
    seconds: float = Field(description="since it said hello")
    mode: Literal["live", "replay", "paused"]
    position: PositionBody | None = Field(description="of the last packet sent; null before the first")
    sent_bytes: int
    thin: bool = Field(description="whether the server draws for it")


class ViewerList(BaseModel):
    """All viewers of a stream."""

    items: list[ViewerBody]


class RecordingBody(BaseModel):
    """The recording of one encoder run of a stream."""

    stream: str
    deleted: bool = Field(description="whether the stream is there no more")
    epoch: int
    begun_at: datetime
    last_group_at: datetime = Field(description="when its newest group of pictures began")
    groups: int
    packets: int
    bytes: int
    path: str = Field(description="download of all of it")


class RecordingList(BaseModel):
    """A page of recordings."""

    items: list[RecordingBody]
    next_cursor: str | None = Field(description="pass it as `cursor` for the next page; null on the last")


class Capabilities(BaseModel):
    """Capabilities of a server as it is set up."""

    recording: bool
    tokens: bool = Field(description="whether tokens are needed")
    thin_viewers: bool = Field(description="whether it draws for viewers that cannot")
    webhooks: bool
    stopping: bool


class ServerBody(BaseModel):
    """A server: version, limits and capabilities."""

    version: str
    protocol_versions: list[int] = Field(description="of the viewer protocol")
    started_at: datetime
    server_time_ns: int = Field(description="Unix time")
    limits: dict[str, float] = Field(description="the settings `limits`")
    retention: dict[str, float] = Field(description="the settings `retention`")
    capabilities: Capabilities
    edges: list[str] = Field(description="addresses of servers at which the same streams can be watched")


class Health(BaseModel):
    """Whether the server works."""

    status: str
    detail: str = ""
