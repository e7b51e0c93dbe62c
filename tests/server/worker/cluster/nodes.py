"""A Ray cluster of several nodes on loopback, of which one can be killed as if its machine were gone."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

ADDRESS = "127.0.0.2"  # Ray takes 127.0.0.1 for the machine's address in its network
_ENVIRONMENT = {
    "RAY_worker_niceness": "0",  # 15 by default, with which an actor starts in a minute on a busy machine
    "RAY_USAGE_STATS_ENABLED": "0",
}
_NODE = {"node_ip_address": ADDRESS, "include_dashboard": False, "object_store_memory": 80_000_000}


class Nodes:
    """The running cluster.

    Attributes:
        address: HOST:PORT.
    """

    def __init__(self, cluster: Any) -> None:
        self._cluster = cluster
        self.address: str = cluster.address

    def kill_worked_on(self) -> None:
        """Kill everything of a node that an actor runs on."""
        (node, *_) = [found for found in self._cluster.worker_nodes if _actors_of(found)]
        for pid in [_raylet(node), *_children(_raylet(node))]:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def actors(self) -> int:
        """How many actors run."""
        return sum(_actors_of(node) for node in self._cluster.worker_nodes)


@contextmanager
def ray_nodes(*cpus: int) -> Iterator[Nodes]:
    """A head without room for actors, and nodes with so many cores each."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        for name, value in _ENVIRONMENT.items():
            patch.setenv(name, value)
        cluster = Cluster(initialize_head=True, head_node_args=_NODE | {"num_cpus": 0})
        try:
            for count in cpus:
                cluster.add_node(wait=False, num_cpus=count, **_NODE)
            cluster.wait_for_nodes()
            yield Nodes(cluster)
        finally:
            cluster.shutdown()


def _raylet(node: Any) -> int:
    (raylet,) = node.all_processes["raylet"]
    return int(raylet.process.pid)


def _children(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False)
    return [int(each) for each in found.stdout.split()]


def _actors_of(node: Any) -> int:
    titles = [subprocess.run(["ps", "-o", "args=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
              for pid in _children(_raylet(node))]  # fmt: skip
    return sum("Actor" in title for title in titles)
