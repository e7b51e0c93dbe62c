"""Prometheus metrics, collected from the registry at each scrape."""

from __future__ import annotations

import time
from collections.abc import Iterable

from prometheus_client import ProcessCollector
from prometheus_client.core import CollectorRegistry, CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from streamlod.core.version import streamlod_version
from streamlod.server.api.registry import Registry
from streamlod.server.auth.gate import EVERYTHING, Grant, Right
from streamlod.server.service.ingest_metrics import Family, ingest_families, labelled
from streamlod.server.stream.stream import Stream

_GAUGE, _COUNTER = GaugeMetricFamily, CounterMetricFamily


def _seconds_since_packet(stream: Stream) -> float:
    """The age of the newest packet; 0 before the first one, and while none are wanted."""
    return time.monotonic() - stream.live_at if stream.live_at and not stream.is_paused else 0.0


_OF_STREAMS: tuple[Family, ...] = (
    (_GAUGE, "viewers", lambda s: s.viewers, "viewers connected"),
    (_GAUGE, "thin_viewers", lambda s: s.thin_viewers, "viewers for which the server draws"),
    (_GAUGE, "live", lambda s: s.state == "live", "1 while packets come"),
    (_GAUGE, "window_bytes", lambda s: s.bus.window.size_bytes, "packets kept in memory"),
    (_GAUGE, "seconds_since_packet", _seconds_since_packet, "age of the newest packet"),
    (_GAUGE, "train_seconds", lambda s: (s.report or {}).get("total_seconds", 0), "training time of the newest frame"),
    (_GAUGE, "anchors", lambda s: s.hub.scene.anchor_count if s.hub.scene else 0, "anchors of the newest state"),
    (_GAUGE, "outbox_bytes", lambda s: s.bus.outbox.waiting_bytes if s.bus.outbox else 0,
     "packets that wait to be taken by JetStream"),
    (_COUNTER, "packets", lambda s: s.counters.packets, "packets published"),
    (_COUNTER, "packet_bytes", lambda s: s.counters.packet_bytes, "bytes of packets published"),
    (_COUNTER, "sent_bytes", lambda s: s.counters.sent_bytes, "bytes of packets sent to viewers"),
    (_COUNTER, "skips", lambda s: s.counters.skips, "times a viewer was brought forward by one residual"),
    (_COUNTER, "stuck", lambda s: s.counters.stuck, "viewers cut off for taking nothing"),
    (_COUNTER, "joins", lambda s: s.counters.joins, "viewers that said hello"),
    (_COUNTER, "pictures", lambda s: s.counters.pictures, "pictures drawn for viewers"),
    (_COUNTER, "picture_bytes", lambda s: s.counters.picture_bytes, "bytes of pictures sent"),
    (_COUNTER, "picture_seconds", lambda s: s.counters.picture_seconds, "time spent on drawing them"),
    (_COUNTER, "thin_refused", lambda s: s.counters.thin_refused, "viewers for which there was no place to draw"),
    (_COUNTER, "worker_restarts", lambda s: s.restarts, "workers that had to be restarted"),
    (_COUNTER, "recording_lost_packets", lambda s: s.bus.recording.lost_packets if s.bus.recording else 0,
     "packets that were not recorded"),
    (_COUNTER, "outbox_lost_packets", lambda s: s.bus.outbox.lost_packets if s.bus.outbox else 0,
     "packets that were not published to JetStream"),
)  # fmt: skip
_OF_NODES: tuple[Family, ...] = ((_GAUGE, "worker_info", lambda _: 1, "1, where a worker runs on a cluster"),)
_REFUSED: tuple[Family, ...] = ((_COUNTER, "refused_tokens", lambda gate: gate.refused, "requests with a wrong token"),)
_BUILD: tuple[Family, ...] = ((_GAUGE, "build_info", lambda _: 1, "1, with the version that runs"),)
_TURNED_AWAY: tuple[Family, ...] = ((_COUNTER, "turned_away", lambda count: count, "connections that were closed"),)


class StreamCollector(Collector):
    """Turns the registry's state into metric families, with a label for the stream.

    Args:
        registry: of the server.
        grant: the figures of streams that it allows; those of the whole server only if it covers all streams.
    """

    def __init__(self, registry: Registry, grant: Grant) -> None:
        self._registry, self._grant = registry, grant

    def collect(self) -> Iterable[Metric]:
        """All families of metrics."""
        streams = {
            name: stream for name, stream in self._registry.streams.items() if self._grant.allows(Right.METRICS, name)
        }
        yield from labelled(_OF_STREAMS, ("stream",), [((name,), stream) for name, stream in streams.items()])
        nodes = [((name, stream.worker_node), stream) for name, stream in streams.items() if stream.worker_node]
        yield from labelled(_OF_NODES, ("stream", "worker_node"), nodes)
        yield from ingest_families({name: stream.ingest for name, stream in streams.items()})
        if self._grant.covers_all:
            yield from labelled(_REFUSED, (), [((), self._registry.gate)])
            yield from labelled(_BUILD, ("version",), [((streamlod_version(),), None)])
            away = [((reason,), count) for reason, count in list(self._registry.turned_away.items())]
            yield from labelled(_TURNED_AWAY, ("reason",), away)


def collector_registry(registry: Registry, grant: Grant = EVERYTHING) -> CollectorRegistry:
    """A Prometheus registry over what `grant` allows of the server's."""
    collectors = CollectorRegistry()
    collectors.register(StreamCollector(registry, grant))
    if grant.covers_all:
        ProcessCollector(registry=collectors)
    return collectors
