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
_STARTS = 3
_NODE = {"node_ip_address": ADDRESS, "include_dashboard": False, "object_store_memory": 80_000_000}


class Nodes:
    """The running cluster.

    Attributes:
        address: HOST:PORT.
    """

    def __init__(self, cluster: Any) -> None:
        self._cluster, self._nodes = cluster, list[Any]()
        self.address: str = cluster.address

    def actors(self) -> list[int]:
        """How many actors run on each node that has not been killed."""
        return [len(_actors_of(node)) for node in self._nodes]

    def oldest(self) -> int:
        """The node of the actor that has run longest: of two, the one that is no spare."""
        ages = [max(_actors_of(node), default=-1) for node in self._nodes]
        return ages.index(max(ages))

    def kill(self, number: int) -> None:
        """Kill all processes of a node, which is then left out."""
        raylet = _raylet(self._nodes.pop(number))
        for pid in [raylet, *_children(raylet)]:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def add(self, cpus: int) -> None:
        """Add a node with so many cores; it is there soon."""
        self._nodes.append(self._cluster.add_node(wait=False, num_cpus=cpus, **_NODE))


@contextmanager
def ray_nodes(*cpus: int) -> Iterator[Nodes]:
    """A head without room for actors, and nodes with so many cores each."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in _ENVIRONMENT.items():
            patch.setenv(name, value)
        cluster = _with_head()
        try:
            nodes = Nodes(cluster)
            for count in cpus:
                nodes.add(count)
            cluster.wait_for_nodes()
            yield nodes
        finally:
            cluster.shutdown()


def _with_head() -> Any:
    """A cluster whose head is up: Ray gives a node half a minute to start, which a busy machine may exceed."""
    from ray.cluster_utils import Cluster

    for tries_left in reversed(range(_STARTS)):
        cluster = Cluster()
        try:
            cluster.add_node(num_cpus=0, **_NODE)
        except Exception as error:
            if "timed out during startup" not in str(error) or not tries_left:
                raise
        else:
            return cluster
    raise AssertionError


def _raylet(node: Any) -> int:
    (raylet,) = node.all_processes["raylet"]
    return int(raylet.process.pid)


def _children(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False)
    return [int(each) for each in found.stdout.split()]


def _actors_of(node: Any) -> list[int]:
    """For how many seconds each of a node's actors has run."""
    pids = ",".join(str(pid) for pid in _children(_raylet(node)))
    found = subprocess.run(["ps", "-o", "etimes=,args=", "-p", pids], capture_output=True, text=True, check=False)
    return [int(line.split()[0]) for line in found.stdout.splitlines() if "Actor" in line]
