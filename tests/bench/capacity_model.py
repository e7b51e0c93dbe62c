"""What many viewers of many streams take: edges, GPUs, storage, bytes, cost, and how long a lost region is felt.

An edge is a process with one core; a machine has as many edges as cores, which share its network. Every region is made
so large that the others carry its viewers when it is lost, each in proportion to its own share of the viewers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float64


@dataclass(frozen=True, slots=True)
class Demand:
    """What is wanted.

    Attributes:
        viewers, streams: how many.
        kbps: of a stream.
        regions: shares of the viewers, which sum to 1.
        popularity: exponent of Zipf's law for how many watch the n-th stream; 0 is all alike.
        retention_seconds: of the past that NATS holds.
    """

    viewers: int = 1_000_000
    streams: int = 100
    kbps: float = 1000.0
    regions: tuple[float, ...] = (0.4, 0.35, 0.25)
    popularity: float = 1.0
    retention_seconds: float = 3600.0

    @property
    def stream_bytes(self) -> float:
        """Bytes of a stream, per second."""
        return self.kbps * 1000 / 8

    @property
    def shares(self) -> Float64:
        """The share of each stream in all viewers."""
        weights = np.arange(1, self.streams + 1, dtype=np.float64) ** -self.popularity
        return weights / weights.sum()


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured (`streamlod bench crowd`), and what is assumed.

    Attributes:
        bytes_per_cpu_second: that an edge sends to viewers.
        join_bytes: that a viewer gets at once when it joins: keyframe and one residual.
        gpus_per_stream: for training.
        cores, gigabits: of a machine for edges, and of its network.
        use: part of its capacity that is planned for.
        replicas: NATS servers that hold each packet.
        edge_hour, gpu_hour, gigabyte, gigabyte_month: prices of a machine for edges and of a GPU, an hour each, of a
            gigabyte sent to viewers, and of a gigabyte stored.
    """

    bytes_per_cpu_second: float = 170e6
    join_bytes: float = 320e3
    gpus_per_stream: float = 1.0
    cores: int = 16
    gigabits: float = 25.0
    use: float = 0.6
    replicas: int = 3
    edge_hour: float = 0.0
    gpu_hour: float = 0.0
    gigabyte: float = 0.0
    gigabyte_month: float = 0.0

    @property
    def edge_bytes(self) -> float:
        """Per second, of an edge at its limit: its core's, or its part of the machine's network."""
        return min(self.bytes_per_cpu_second, self.gigabits * 1e9 / 8 / self.cores)


@dataclass(frozen=True, slots=True)
class Plan:
    """What it takes.

    Attributes:
        edges: processes in each region.
        machines: for all of them.
        viewers_per_edge: with all regions there.
        origin_bytes, parent_bytes: per second from the origin, where edges pull from it, and where each region has one
            edge from which its others pull.
        load, load_after: part of an edge's limit in use, in the mean of all regions, and of the worst region after the
            worst loss.
        lost_viewers: of that region.
        recovery_seconds: from when they come until the last of them has a picture.
        gpus, storage_bytes, hour: the rest; `hour` is the cost of one.
    """

    edges: tuple[int, ...]
    machines: int
    viewers_per_edge: float
    origin_bytes: float
    parent_bytes: float
    load: float
    load_after: float
    lost_viewers: int
    recovery_seconds: float
    gpus: int
    storage_bytes: float
    hour: float


def plan(demand: Demand, figures: Figures) -> Plan:
    """Make every region large enough, and say what that costs.

    Raises:
        ValueError: shares of regions do not sum to 1, or are not positive.
    """
    shares = np.array(demand.regions)
    if len(shares) < 2 or (shares <= 0).any() or abs(shares.sum() - 1) > 1e-6:
        raise ValueError("there have to be two regions or more, with positive shares that sum to 1")
    rate, limit = demand.stream_bytes, figures.edge_bytes
    edges = tuple(
        math.ceil(demand.viewers * share / (1 - np.delete(shares, n).max()) * rate / (limit * figures.use))
        for n, share in enumerate(shares)
    )
    viewers = demand.viewers * shares
    lost = int(np.argmax(shares))
    left = np.delete(np.array(edges), lost)
    after = np.delete(viewers, lost) / (1 - shares[lost])
    per_edge = viewers / np.array(edges)
    hourly_bytes = demand.viewers * rate * 3600
    storage = demand.streams * rate * demand.retention_seconds * figures.replicas
    machines = sum(math.ceil(each / figures.cores) for each in edges)
    gpus = math.ceil(demand.streams * figures.gpus_per_stream)
    return Plan(
        edges,
        machines,
        demand.viewers / sum(edges),
        float(sum(n * distinct(demand.shares, each) for n, each in zip(edges, per_edge, strict=True)) * rate),
        float(sum(distinct(demand.shares, each) for each in viewers) * rate),
        demand.viewers * rate / (sum(edges) * limit),
        float((after / left * rate / limit).max()),
        int(viewers[lost]),
        max(_recovery(*each, demand, figures) for each in zip(np.delete(viewers, lost), after, left, strict=True)),
        gpus,
        storage,
        machines * figures.edge_hour
        + gpus * figures.gpu_hour
        + hourly_bytes / 1e9 * figures.gigabyte
        + storage / 1e9 * figures.gigabyte_month / 730,
    )


def distinct(shares: Float64, viewers: float) -> float:
    """How many different streams so many viewers watch, on average."""
    return float((1 - (1 - shares) ** viewers).sum())


def _recovery(before: float, after: float, edges: int, demand: Demand, figures: Figures) -> float:
    """Seconds in which the edges of a region take on viewers, from `before` to `after`, who all come at once.

    What is not needed for those that watch goes into joins: n' = (limit - n rate) / join_bytes.
    """
    limit, rate = edges * figures.edge_bytes, demand.stream_bytes
    if after * rate >= limit:
        return math.inf
    return figures.join_bytes / rate * math.log((limit - before * rate) / (limit - after * rate))
