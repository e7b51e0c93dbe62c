"""Reserves room for a worker on a node of a Ray cluster; Ray's placement groups show what is already reserved."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import ray
from ray.util import placement_group, placement_group_table, remove_placement_group
from ray.util.placement_group import PlacementGroup
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy

from streamlod.core.errors import BackendUnavailable
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import RaySettings
from streamlod.server.worker.cluster.actor import WorkerActor
from streamlod.server.worker.cluster.link import LinkAddress
from streamlod.server.worker.cluster.room import Amounts, Holding, NoRoom, needs, shortage

_LOG = logging.getLogger(__name__)
_MARK = "streamlod"  # a placement group's name has this, the stream's id and something that makes it unique
_AWAY_SECONDS = 1.0  # to find a node that has no worker of the same stream
_SECONDS = 3.0  # to find any node; what a killed worker held is free again within that


@dataclass(frozen=True, slots=True)
class Place:
    """Room for one worker.

    Attributes:
        group: Ray's reservation.
        needed: what is reserved.
        host: address of the node, ``unknown`` if it was lost meanwhile.
    """

    group: PlacementGroup
    needed: Amounts
    host: str

    def start(self, spec: StreamSpec, back: LinkAddress, spare: bool, camera_pictures: bool) -> Future[Any]:
        """Start an actor that connects to `back`; the result is done when it has ended, for whatever reason."""
        actor: Any = ray.remote(WorkerActor).options(
            num_cpus=self.needed["CPU"],
            num_gpus=self.needed.get("GPU", 0),
            scheduling_strategy=PlacementGroupSchedulingStrategy(self.group),
        )
        running = actor.remote().run.remote(spec, back, self.needed["CPU"], spare, camera_pictures)
        ended: Future[Any] = running.future()
        return ended


@contextmanager
def joined(settings: RaySettings) -> Iterator[str]:
    """Connect to the cluster and yield this machine's address; leaving the context frees all that was reserved.

    Raises:
        BackendUnavailable: there is no cluster there.
    """
    try:
        ray.init(address=settings.address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:  # as Ray says that it found none
        _LOG.warning("there is no Ray cluster at %r (%.200s)", settings.address, error)
        remedy = "start it: ray start --head, and on other machines ray start --address HOST:6379"
        raise BackendUnavailable("the Ray cluster", remedy) from error
    try:
        yield ray.util.get_node_ip_address()  # type: ignore[no-untyped-call]
    finally:
        ray.shutdown()


def reserve(stream: str, settings: RaySettings) -> Place:
    """Room for one more worker of a stream, on a node that has none of it if possible.

    Raises:
        NoRoom: there is none now.
    """
    needed = needs(settings.cpus, settings.gpus)
    taken = {each.node for each in _holdings() if each.holder == stream}
    group = _try(stream, needed, taken, _AWAY_SECONDS) if taken else None
    group = group or _try(stream, needed, set(), _SECONDS)
    nodes = {node["NodeID"]: node for node in ray.nodes() if node["Alive"]}  # type: ignore[no-untyped-call]
    totals = {name: node["Resources"] for name, node in nodes.items()}
    if group is None:
        raise NoRoom(f"stream {stream}", shortage(needed, totals, _holdings()))
    node = nodes.get(placement_group_table(group)["bundles_to_node_id"][0])
    return Place(group, needed, "unknown" if node is None else node["NodeManagerAddress"])


def _try(stream: str, needed: Amounts, avoided: set[str], seconds: float) -> PlacementGroup | None:
    """A reservation on a node outside `avoided`; None if Ray finds no room within `seconds`."""
    selector = {"ray.io/node-id": f"!in({','.join(sorted(avoided))})"} if avoided else {}
    name = f"{_MARK}:{stream}:{secrets.token_hex(4)}"
    group: PlacementGroup = placement_group([dict(needed)], name=name, bundle_label_selector=[selector])
    if group.wait(seconds):
        return group
    remove_placement_group(group)
    return None


def _holdings() -> list[Holding]:
    """The reservations of streams and of other programs that use placement groups."""
    found = []
    for group in placement_group_table().values():
        mark, _, rest = group["name"].partition(":")
        holder = rest.partition(":")[0] if mark == _MARK else ""
        if group["state"] == "CREATED":
            nodes = group["bundles_to_node_id"]
            found += [Holding(holder, nodes[number], amounts) for number, amounts in group["bundles"].items()]
    return found
