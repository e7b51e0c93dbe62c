"""Prometheus families about live cameras, from what workers tell of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

_Figures = dict[str, Any]
# kind, name without its prefix, value of one labelled thing, help
Family = tuple[type[GaugeMetricFamily] | type[CounterMetricFamily], str, Callable[[Any], float], str]
_GAUGE, _COUNTER = GaugeMetricFamily, CounterMetricFamily

_OF_RIGS: tuple[Family, ...] = (
    (_GAUGE, "ingest_latency_seconds", lambda rig: rig["latency_ns"] / 1e9, "from filming to the start of training"),
    (_COUNTER, "ingest_frames", lambda rig: rig["delivered"], "instants given to training"),
    (_COUNTER, "ingest_dropped_stale", lambda rig: rig["dropped_stale"], "instants that training was too slow for"),
    (_COUNTER, "ingest_dropped_incomplete", lambda rig: rig["dropped_incomplete"], "instants with too few cameras"),
    (_COUNTER, "ingest_clock_steps", lambda rig: rig["clock_steps"], "times that most cameras' clocks were stepped"),
    (_GAUGE, "pose_faults", lambda rig: len(rig["poses"]), "faults of the cameras' poses, by what cameras share"),
)
_OF_CAMERAS: tuple[Family, ...] = (
    (_GAUGE, "camera_lost", lambda one: one["state"] == "lost", "1 while a camera delivers nothing"),
    (_GAUGE, "camera_knocked", lambda one: one["knocked"], "1 while it does not stand as it did when it was opened"),
    (_GAUGE, "camera_skew_seconds", lambda one: one["counts"]["skew_ns"] / 1e9, "distance of pictures from the grid"),
    (_GAUGE, "camera_clock_error_seconds", lambda one: one["error_ns"] / 1e9, "how far off its times may be"),
    (_GAUGE, "camera_drift_ppm", lambda one: one["drift_ppm"], "how much slower its clock runs than the wall's"),
    (_COUNTER, "camera_pictures", lambda one: one["counts"]["received"], "pictures that came"),
    (_COUNTER, "camera_late", lambda one: one["counts"]["late"], "pictures that came after their instant"),
    (_COUNTER, "camera_missing", lambda one: one["counts"]["missing"], "instants without its picture"),
    (_COUNTER, "camera_duplicate", lambda one: one["counts"]["duplicate"], "pictures that shared an instant"),
    (_COUNTER, "camera_stray", lambda one: one["counts"]["stray"], "pictures with an impossible time"),
    (_COUNTER, "camera_connections", lambda one: one["connections"], "times that it was connected"),
)


def ingest_families(streams: Mapping[str, _Figures | None]) -> Iterable[Metric]:
    """All families of metrics, with the labels stream and, for a camera's, camera.

    Args:
        streams: what each stream's worker told last, as `Statistics` in JSON; None where it is not live.
    """
    rigs = [((name,), rig) for name, rig in streams.items() if rig is not None]
    cameras = [((*label, camera), one) for label, rig in rigs for camera, one in rig["cameras"].items()]
    yield from labelled(_OF_RIGS, ("stream",), rigs)
    yield from labelled(_OF_CAMERAS, ("stream", "camera"), cameras)


def labelled(
    families: Iterable[Family], labels: Sequence[str], rows: Sequence[tuple[Sequence[str], Any]]
) -> Iterable[Metric]:
    """Each family with a value for each row: the values of its `labels`, and the thing that the value is of."""
    for kind, name, value, text in families:
        family = kind(f"streamlod_{name}", text, labels=labels)
        for label, thing in rows:
            family.add_metric(label, float(value(thing)))
        yield family
