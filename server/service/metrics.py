"""Prometheus metrics, collected from the registry at each scrape."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

from prometheus_client import ProcessCollector
from prometheus_client.core import CollectorRegistry, CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from streamlod.core.version import streamlod_version
from streamlod.server.api.registry import Registry
from streamlod.server.auth.gate import EVERYTHING, Grant, Right
from streamlod.server.service.ingest_metrics import ingest_families
from streamlod.server.stream.stream import Stream

_GAUGES = {
    "viewers": "viewers connected",
    "thin_viewers": "viewers for which the server draws",
    "live": "1 while packets come",
    "window_bytes": "packets kept in memory",
    "seconds_since_packet": "age of the newest packet",
    "train_seconds": "training time of the newest frame",
    "anchors": "anchors of the newest state",
    "outbox_bytes": "packets that wait to be taken by JetStream",
}
_COUNTERS = {
    "packets": "packets published",
    "packet_bytes": "bytes of packets published",
    "sent_bytes": "bytes of packets sent to viewers",
    "skips": "times a viewer was brought forward by one residual",
    "stuck": "viewers cut off for taking nothing",
    "joins": "viewers that said hello",
    "pictures": "pictures drawn for viewers",
    "picture_bytes": "bytes of pictures sent",
    "picture_seconds": "time spent on drawing them",
    "thin_refused": "viewers for which there was no place to draw",
    "worker_restarts": "workers that had to be restarted",
    "recording_lost_packets": "packets that were not recorded",
    "outbox_lost_packets": "packets that were not published to JetStream",
}


class StreamCollector(Collector):
    """Turns the registry's state into metric families, with a label for the stream.

    Args:
        registry: of the server.
        grant: the figures of streams that it allows; those of the whole server only if it covers all streams.
    """

    def __init__(self, registry: Registry, grant: Grant = EVERYTHING) -> None:
        self._registry, self._grant = registry, grant

    def collect(self) -> Iterable[Metric]:
        """All families."""
        gauges = {
            name: GaugeMetricFamily(f"streamlod_{name}", text, labels=["stream"]) for name, text in _GAUGES.items()
        }
        counters = {
            name: CounterMetricFamily(f"streamlod_{name}", text, labels=["stream"]) for name, text in _COUNTERS.items()
        }
        streams = {
            name: stream for name, stream in self._registry.streams.items() if self._grant.allows(Right.METRICS, name)
        }
        for label, stream in streams.items():
            counts, recording, outbox = stream.counters, stream.bus.recording, stream.bus.outbox
            scene = stream.hub.scene
            values = {
                "viewers": stream.viewers,
                "thin_viewers": stream.thin_viewers,
                "live": float(stream.state == "live"),
                "window_bytes": stream.bus.window.size_bytes,
                "seconds_since_packet": time.monotonic() - stream.live_at
                if stream.live_at and not stream.is_paused
                else 0.0,
                "train_seconds": float((stream.report or {}).get("total_seconds", 0.0)),
                "anchors": scene.anchor_count if scene else 0,
                "outbox_bytes": outbox.waiting_bytes if outbox else 0,
            }
            for name, value in values.items():
                gauges[name].add_metric([label], value)
            totals = {
                "packets": counts.packets,
                "packet_bytes": counts.packet_bytes,
                "sent_bytes": counts.sent_bytes,
                "skips": counts.skips,
                "stuck": counts.stuck,
                "joins": counts.joins,
                "pictures": counts.pictures,
                "picture_bytes": counts.picture_bytes,
                "picture_seconds": counts.picture_seconds,
                "thin_refused": counts.thin_refused,
                "worker_restarts": stream.restarts,
                "recording_lost_packets": recording.lost_packets if recording else 0,
                "outbox_lost_packets": outbox.lost_packets if outbox else 0,
            }
            for name, value in totals.items():
                counters[name].add_metric([label], value)
        yield from gauges.values()
        yield from counters.values()
        yield _workers(streams)
        yield from ingest_families({name: stream.ingest for name, stream in streams.items()})
        if self._grant.covers_all:
            yield from self._server_families()

    def _server_families(self) -> Iterable[Metric]:
        refused = CounterMetricFamily("streamlod_refused_tokens", "requests with a wrong token")
        refused.add_metric([], self._registry.gate.refused)
        yield refused
        build = GaugeMetricFamily("streamlod_build_info", "1, with the version that runs", labels=["version"])
        build.add_metric([streamlod_version()], 1)
        yield build
        away = CounterMetricFamily("streamlod_turned_away", "connections that were closed", labels=["reason"])
        for reason, count in list(self._registry.turned_away.items()):
            away.add_metric([reason], count)
        yield away


def _workers(streams: Mapping[str, Stream]) -> Metric:
    """Which node of a cluster each worker runs on."""
    family = GaugeMetricFamily(
        "streamlod_worker_info", "1, where a worker runs on a cluster", labels=["stream", "worker_node"]
    )
    for name, stream in streams.items():
        if stream.worker_node:
            family.add_metric([name, stream.worker_node], 1)
    return family


def collector_registry(registry: Registry, grant: Grant = EVERYTHING) -> CollectorRegistry:
    """A Prometheus registry over what `grant` allows of the server's."""
    collectors = CollectorRegistry()
    collectors.register(StreamCollector(registry, grant))
    if grant.covers_all:
        ProcessCollector(registry=collectors)
    return collectors


def _seconds_since_packet(stream: Stream) -> float:
    """The age of the newest packet; 0 before the first one, and while none are wanted."""
    return time.monotonic() - stream.live_at if stream.live_at and not stream.is_paused else 0.0
