"""Every setting of the server, with its default; docs/operations.md explains them to people who run one."""

from __future__ import annotations

import ipaddress
import re
import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from streamlod.codec.packet.limits import DecoderLimits
from streamlod.core.errors import InputError
from streamlod.core.field_faults import first_fault
from streamlod.server.pipeline.new_stream import NewStream

MEGABYTE = 1_000_000
_ORIGIN = re.compile(r"https?://[A-Za-z0-9.*-]+(:\d{1,5})?")


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Limits(_Strict):
    """Limits on what one peer, one stream or the whole server may take."""

    streams: int = Field(default=16, ge=1, description="streams at most")
    viewers: int = Field(default=1000, ge=1, description="viewers of all streams together")
    viewers_per_address: int = Field(default=200, ge=1, description="viewers from one network address")
    connections: int = Field(default=2000, ge=1, description="connections of any kind; further ones get 503")
    handshakes_per_address: int = Field(
        default=64, ge=1, description="TLS handshakes from one network address at the same time"
    )
    packet_bytes: int = Field(default=16 * 2**20, ge=1024, description="largest packet that is accepted from a worker")
    state_bytes: int = Field(
        default=64 * 2**20, ge=2**20, description="memory of a decoded scene; a stream that needs more is refused"
    )
    anchors: int = Field(default=2**18, ge=1, description="anchors of a decoded scene")
    gaussians: int = Field(default=2**21, ge=1, description="Gaussians of a decoded scene")
    request_bytes: int = Field(default=65536, ge=4096, description="largest head, and largest body, of a REST request")
    request_seconds: float = Field(default=10.0, gt=0, description="time in which a request must have arrived whole")
    message_bytes: int = Field(default=4096, ge=256, description="largest control message")
    messages_per_second: float = Field(default=50.0, gt=0, description="control messages of a viewer, on average")
    hello_seconds: float = Field(default=5.0, gt=0, description="time a viewer has to say hello")
    stuck_seconds: float = Field(default=30.0, gt=0, description="a viewer that takes no byte for so long is closed")
    download_bytes_per_second: float = Field(
        default=8192, ge=0, description="a download that is read more slowly, over `stuck_seconds`, is cut off"
    )
    viewer_bytes: int = Field(
        default=128 * 1024, ge=4096, description="socket buffer of a viewer, and how far it may lag"
    )
    viewer_lag_seconds: float = Field(
        default=1.0, gt=0, description="how far a viewer may lag before packets are skipped"
    )
    flight_bytes: int = Field(
        default=16 * MEGABYTE, ge=65536, description="bytes sent but not acknowledged, above a keyframe"
    )
    thin_viewers: int = Field(default=4, ge=0, description="viewers for which the server draws; 0 for none")
    thin_pixels: int = Field(default=921_600, ge=4096, le=2**25, description="largest picture drawn for a viewer")
    refusals_per_minute: int = Field(default=30, ge=1, description="wrong tokens from one address before it gets 429")

    @property
    def decoder(self) -> DecoderLimits:
        """Limits of the server's decoders."""
        return DecoderLimits(
            packet_bytes=self.packet_bytes,
            anchors=self.anchors,
            gaussians=self.gaussians,
            state_bytes=self.state_bytes,
        )


class Retention(_Strict):
    """The past that is kept, for seeking back and for downloads."""

    memory_bytes: int = Field(default=32 * MEGABYTE, ge=MEGABYTE, description="packets of one stream kept in memory")
    seconds: float = Field(default=3600.0, gt=0, description="age at which recorded groups of pictures are deleted")
    bytes: int = Field(
        default=4_000 * MEGABYTE, ge=MEGABYTE, description="recorded bytes of one stream, its sound counted"
    )
    reserve_fraction: float = Field(default=0.05, ge=0, lt=1, description="part of the disk that recording leaves free")


class Webhook(_Strict):
    """A program that is told what happens, by POST (docs/protocol.md)."""

    url: str = Field(pattern=r"^https?://[^/@\s]+(/\S*)?$", max_length=2000, description="where to")
    key: Path = Field(description="file with the secret that signs, of at least 32 characters")
    events: tuple[str, ...] = Field(default=("*",), description="kinds of events, as shell patterns")
    streams: str = Field(default="*", description="ids of streams, as a shell pattern")


class WorkerSettings(_Strict):
    """How workers are watched."""

    heartbeat_seconds: float = Field(
        default=30.0, gt=0, description="a worker silent for so long is killed and restarted"
    )
    start_seconds: float = Field(
        default=180.0, gt=0, description="a worker that has said nothing so long after its start is replaced"
    )
    stall_seconds: float = Field(default=600.0, gt=0, description="so long without progress counts as a hang")
    memory_bytes: int = Field(
        default=16_000 * MEGABYTE, gt=0, description="resident memory at which a worker is restarted"
    )
    first_delay_seconds: float = Field(
        default=0.25, gt=0, description="pause before the first restart; doubles each time"
    )
    longest_delay_seconds: float = Field(default=15.0, gt=0, description="longest pause between restarts")
    spare: bool = Field(
        default=True, description="keep a second process waiting beside one that trains, which takes over at once"
    )
    attempts: int = Field(
        default=8, ge=1, description="restarts in a row without a packet before the stream has failed"
    )


class RaySettings(_Strict):
    """Run workers on a Ray cluster."""

    address: str = Field(
        default="auto", description="HOST:PORT of the cluster, of which this machine is a node; auto finds it"
    )
    cpus: float = Field(default=1.0, gt=0, description="cores that a worker reserves and uses; may be fractions")
    gpus: float = Field(default=0.0, ge=0, description="GPUs that a worker reserves: a part of one, or whole ones")


class EdgeSettings(_Strict):
    """Serve the streams of another server."""

    origin: str = Field(description="address of that server; its token comes from STREAMLOD_TOKEN")
    streams: tuple[str, ...] = Field(default=(), description="which of its streams; all by default")
    linger_seconds: float = Field(
        default=10.0, ge=0, description="a stream is pulled for so long after its last viewer"
    )
    poll_seconds: float = Field(default=2.0, gt=0, description="time between two looks at which streams there are")


class JetStreamSettings(_Strict):
    """Share streams with other servers over NATS JetStream."""

    servers: tuple[str, ...] = Field(default=("nats://127.0.0.1:4222",), description="addresses of NATS servers")
    prefix: str = Field(
        default="streamlod",
        pattern="^[A-Za-z0-9_-]{1,32}$",
        description="of names in NATS; servers that share streams have the same one",
    )
    credentials: Path | None = Field(default=None, description="file with the NATS user's token and seed (.creds)")
    replicas: int = Field(default=1, ge=1, le=5, description="NATS servers that each packet is kept on")
    linger_seconds: float = Field(
        default=10.0, ge=0, description="a stream of another server is read for so long after its last viewer"
    )


class Settings(_Strict):
    """The whole configuration, from the command line or a TOML file of the same names."""

    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: int = Field(default=8000, ge=0, le=65535, description="port of REST, websocket and page; 0 picks a free one")
    metrics_host: str = Field(default="127.0.0.1", description="address of the Prometheus metrics")
    metrics_port: int | None = Field(default=None, ge=0, le=65535, description="port of the metrics; none by default")
    trace_endpoint: str | None = Field(
        default=None,
        pattern=r"^https?://[^/@\s]+(/\S*)?$",
        description="OpenTelemetry collector (OTLP over HTTP) that is told of each frame's way; none by default",
    )
    log_format: Literal["text", "json"] = Field(
        default="text", description="lines of the log: for people, or JSON objects for programs"
    )
    access_log: bool = Field(default=False, description="a line of the log for every HTTP request")
    state: Path | None = Field(default=None, description="folder of recordings; nothing is recorded without")
    tokens: Path | None = Field(default=None, description="token file; without one everybody may do everything")
    jwt_key: Path | None = Field(default=None, description="file with the HS256 secret or the Ed25519 public key (PEM)")
    jwks: str | None = Field(default=None, description="JSON web key set: a file, or an https address that is fetched")
    revoked: Path | None = Field(
        default=None, description="file of JSON web tokens that count no more: a line each, `jti` or SHA-256"
    )
    link_key: Path | None = Field(
        default=None,
        description="file with the secret that signs download links; without one they end with the process",
    )
    insecure: bool = Field(default=False, description="allow a public address without tokens")
    origins: tuple[str, ...] = Field(
        default=(), description="origins of web pages that may connect besides the server's own"
    )
    hosts: tuple[str, ...] = Field(
        default=(), description="host names that the server answers to besides local ones, addresses and `origins`"
    )
    proxies: tuple[str, ...] = Field(
        default=(), description="addresses and networks (CIDR) of proxies whose X-Forwarded-For is believed"
    )
    roots: tuple[Path, ...] = Field(
        default=(),
        description="folders that streams created over REST may read, besides what their creator may watch",
    )
    networks: tuple[str, ...] = Field(
        default=(), description="networks (CIDR) and host names that their cameras may be at, besides public addresses"
    )
    listen: tuple[str, ...] = Field(
        default=(), description="ADDRESS:PORT at which their cameras may push to the server"
    )
    frame_ancestors: tuple[str, ...] = Field(
        default=(), description="origins of sites that may show the page in a frame"
    )
    camera_pictures: bool = Field(
        default=False, description="who may watch a stream that is trained may also see small pictures of its cameras"
    )
    together: bool = Field(
        default=False, description="viewers with the right `present` may show others where they look, who follow them"
    )
    certificate: Path | None = Field(default=None, description="TLS certificate chain (PEM)")
    certificate_key: Path | None = Field(default=None, description="TLS private key (PEM)")
    drain_seconds: float = Field(default=8.0, gt=0, le=10, description="time that viewers get to leave after SIGTERM")
    webhooks: tuple[Webhook, ...] = Field(
        default=(), description="programs that are told what happens, as `[[webhooks]]`"
    )
    on_demand_seconds: float = Field(
        default=10.0,
        ge=0,
        description="a stream on demand stops, and `serve --play` pauses, so long after its last viewer",
    )
    streams: tuple[NewStream, ...] = Field(
        default=(), description="streams to start with, as `[[streams]]`; fields as in `POST /v1/streams`"
    )
    limits: Limits = Field(default_factory=Limits)
    retention: Retention = Field(default_factory=Retention)
    worker: WorkerSettings = Field(default_factory=WorkerSettings)
    jobs: Literal["local", "ray"] = Field(
        default="local", description="where streams are trained: in processes of this machine, or on a Ray cluster"
    )
    ray: RaySettings = Field(default_factory=RaySettings, description='for `jobs = "ray"`, as `[ray]`')
    bus: Literal["local", "jetstream"] = Field(
        default="local", description="where packets go besides viewers: nowhere, or to NATS JetStream for other servers"
    )
    jetstream: JetStreamSettings = Field(
        default_factory=JetStreamSettings, description='for `bus = "jetstream"`, as `[jetstream]`'
    )
    edges: tuple[str, ...] = Field(
        default=(), description="addresses of edges that serve the same streams; viewers are told of them"
    )
    edge: EdgeSettings | None = Field(default=None, description="serve the streams of another server, as `[edge]`")

    @property
    def has_tokens(self) -> bool:
        """Whether anything needs a token."""
        return not (self.tokens is None and self.jwt_key is None and self.jwks is None)

    @property
    def is_public(self) -> bool:
        """Whether other machines can reach the listening address."""
        if self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True

    def check(self) -> None:
        """Refuse combinations that are not safe.

        Raises:
            InputError: a public address without tokens, an edge with streams, recordings or a bus of its own, part of a
                second GPU, half a certificate, or networks or origins that are none.
        """
        if self.is_public and not (self.has_tokens or self.insecure):
            raise InputError(
                f"--host {self.host}",
                "other machines could control this server; give it --tokens FILE, or --insecure if that is meant",
            )
        if self.edge is not None and (self.streams or self.state is not None):
            raise InputError("edge", "an edge has neither streams nor a state folder of its own; leave them out")
        if self.edge is not None and self.bus != "local":
            raise InputError("bus", "an edge gets its streams from its origin; leave out `bus`, or `edge`")
        if self.ray.gpus > 1 and self.ray.gpus % 1:
            raise InputError("ray.gpus", f"is a part of one GPU, or whole ones, not {self.ray.gpus:g}")
        if (self.certificate is None) != (self.certificate_key is None):
            raise InputError("certificate", "TLS needs both the certificate and its key")
        for name, network in (
            *(("networks", network) for network in self.networks if "/" in network),
            *(("proxies", network) for network in self.proxies),
        ):
            try:
                ipaddress.ip_network(network)
            except ValueError as error:
                raise InputError(name, f"{error}; write 10.0.0.0/8") from error
        for name in ("origins", "frame_ancestors", "edges"):
            for origin in getattr(self, name):
                if not _ORIGIN.fullmatch(origin):
                    raise InputError(name, f"{origin!r:.80} is not an origin; write https://stage.example")


def load_settings(path: Path) -> Settings:
    """Settings from a TOML file.

    Raises:
        InputError: the file cannot be read, or names or values are wrong.
    """
    try:
        return Settings.model_validate(tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(path, f"cannot be read as TOML ({error})") from error
    except ValidationError as error:
        place, fault = first_fault(error.errors())
        raise InputError(path, f"{place}: {fault}") from error
