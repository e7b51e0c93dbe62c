"""Every viewer by itself: which region, edge and stream it is at, and how the largest region is lost.

What `capacity_model` computes from means is counted here. A viewer takes any edge of its region, all alike, as behind a
load balancer or by the first to answer. When a region is lost, all its viewers come to the others at once; each edge
serves those that watch first, and lets viewers join, in the order in which they came, with what is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float64, Int64
from tests.bench.capacity_model import Demand, Figures, Plan

_STEP_SECONDS = 0.05
_MAX_SECONDS = 600.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What happened.

    Attributes:
        origin_bytes, parent_bytes: per second, as in `Plan`, before the loss.
        load, worst_load: part of an edge's limit in use before, in the mean and at the fullest edge.
        load_after: of the region that is fullest after the loss; worst_load_after: of the fullest edge.
        recovery_seconds: until 99 % of the viewers of the lost region have a picture again; last_seconds: all of them.
    """

    origin_bytes: float
    parent_bytes: float
    load: float
    worst_load: float
    load_after: float
    worst_load_after: float
    recovery_seconds: float
    last_seconds: float


def simulate(demand: Demand, figures: Figures, planned: Plan, seed: int = 0) -> Outcome:
    """Let viewers choose, lose the largest region, and watch the others take on its viewers."""
    random = np.random.default_rng(seed)
    edges, rate, limit = np.array(planned.edges), demand.stream_bytes, figures.edge_bytes
    first = np.concatenate(([0], np.cumsum(edges)))  # edge of each region
    region = random.choice(len(edges), demand.viewers, p=demand.regions)
    stream = random.choice(demand.streams, demand.viewers, p=demand.shares)
    edge = first[region] + (random.random(demand.viewers) * edges[region]).astype(np.int64)
    watching = np.bincount(edge, minlength=first[-1]).astype(np.float64)

    lost = int(np.argmax(demand.regions))
    coming_from = region == lost
    weights = np.array(demand.regions) * (np.arange(len(edges)) != lost)
    new_region = random.choice(len(edges), int(coming_from.sum()), p=weights / weights.sum())
    new_edge = first[new_region] + (random.random(len(new_region)) * edges[new_region]).astype(np.int64)
    left = np.ones(first[-1], dtype=bool)
    left[first[lost] : first[lost + 1]] = False
    coming = np.bincount(new_edge, minlength=first[-1]).astype(np.float64)[left]
    times = _joins(watching[left], coming, rate, limit, figures.join_bytes)
    after = (watching[left] + coming) * rate / limit
    by_region = [
        after[np.arange(first[-1])[left].searchsorted(first[n]) :][: edges[n]].mean()
        for n in range(len(edges))
        if n != lost
    ]
    return Outcome(
        _pairs(edge, stream, demand) * rate,
        _pairs(region, stream, demand) * rate,
        float(watching.mean() * rate / limit),
        float(watching.max() * rate / limit),
        float(max(by_region)),
        float(after.max()),
        float(np.percentile(times, 99, method="higher")),
        float(times.max()),
    )


def _pairs(place: Int64, stream: Int64, demand: Demand) -> int:
    """How many streams are pulled, over all places."""
    return len(np.unique(place * demand.streams + stream))


def _joins(watching: Float64, coming: Float64, rate: float, limit: float, join_bytes: float) -> Float64:
    """Seconds after which each viewer that comes has joined; infinite where an edge has nothing left for joins."""
    joined, found, now = np.zeros_like(coming), [np.zeros(0)], 0.0
    while (joined < coming).any() and now < _MAX_SECONDS:
        now += _STEP_SECONDS
        spare = np.maximum(0.0, limit - (watching + joined) * rate)
        before, joined = np.floor(joined), np.minimum(coming, joined + spare * _STEP_SECONDS / join_bytes)
        found.append(np.full(int((np.floor(joined) - before).sum()), now))
    missing = int(coming.sum()) - sum(map(len, found))
    return np.concatenate([*found, np.full(max(0, missing), np.inf)])
