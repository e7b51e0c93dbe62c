"""The needs of a worker in a cluster, and why there is no room for it: plain values, for which Ray is not loaded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from streamlod.core.errors import InputError

Amounts = Mapping[str, float]  # by resource: CPU, GPU
_EXACT = 1e-4  # Ray counts in ten-thousandths


@dataclass(frozen=True, slots=True)
class Shortage:
    """Why there is no room for a worker.

    Attributes:
        text: what it needs, and why that is not to be had.
        ways: ids of streams that would have to stop; all of one of these sets.
    """

    text: str
    ways: tuple[tuple[str, ...], ...] = ()

    def sentence(self, may_see: Callable[[str], bool] = lambda _: False) -> str:
        """The refusal for somebody who may see these streams; by default for everybody."""
        ways = [" and ".join(way) for way in self.ways if all(map(may_see, way))]
        if self.ways:
            return f"{self.text}; stop {', or '.join(ways) or 'other streams, or add a node'}"
        return self.text


class NoRoom(InputError):
    """A cluster has no room for a stream's worker."""

    def __init__(self, subject: str, shortage: Shortage) -> None:
        super().__init__(subject, shortage.sentence())
        self.shortage = shortage


@dataclass(frozen=True, slots=True)
class Holding:
    """A reservation on a node.

    Attributes:
        holder: a stream's id, or "" for another program.
        node: its id.
        amounts: of resources.
    """

    holder: str
    node: str
    amounts: Amounts


def needs(cpus: float, gpus: float) -> dict[str, float]:
    """The resources of one worker."""
    return {"CPU": cpus, **({"GPU": gpus} if gpus else {})}


def shortage(needed: Amounts, nodes: Mapping[str, Amounts], holdings: Sequence[Holding]) -> Shortage:
    """Why a worker finds no room, and what would have to stop.

    Args:
        needed: by the worker.
        nodes: all that each node has, by its id.
        holdings: what is reserved there.
    """
    wanted = f"it needs {in_words(needed)} on one node of the cluster"
    large = [node for node, amounts in nodes.items() if _fits(needed, amounts)]
    if not large:
        return Shortage(f"{wanted}, and no node is that large; ask for less, or add a node")
    ways = {way for node in large if (way := _to_stop(needed, nodes[node], holdings, node))}
    if not ways:
        return Shortage(f"{wanted}, and other programs hold them; wait for these, or add a node")
    fewest_first = sorted(ways, key=lambda way: (len(way), way))
    return Shortage(f"{wanted}, and none has them free", tuple(fewest_first))


def in_words(amounts: Amounts) -> str:
    """Resources in words, such as "2 CPU and 0.5 GPU"."""
    return " and ".join(f"{amount:g} {name}" for name, amount in amounts.items())


def _fits(needed: Amounts, free: Amounts) -> bool:
    return all(free.get(name, 0.0) >= amount - _EXACT for name, amount in needed.items())


def _to_stop(needed: Amounts, total: Amounts, holdings: Sequence[Holding], node: str) -> tuple[str, ...]:
    """Streams of a node that make room when they stop, few of them; none where that does not help."""
    here = [each for each in holdings if each.node == node]
    free = {name: amount - sum(each.amounts.get(name, 0.0) for each in here) for name, amount in total.items()}
    streams = {each.holder for each in here if each.holder}
    held = {
        stream: {name: sum(each.amounts.get(name, 0.0) for each in here if each.holder == stream) for name in needed}
        for stream in streams
    }
    stopped: list[str] = []
    while not _fits(needed, free) and len(stopped) < len(streams):
        missing = {name: amount - free.get(name, 0.0) for name, amount in needed.items()}

        def use(stream: str, missing: dict[str, float] = missing) -> tuple[float, str]:
            """How much of what is missing its end gives."""
            return -sum(min(held[stream][name], max(0.0, lack)) for name, lack in missing.items()), stream

        best = min(streams - set(stopped), key=use)
        stopped.append(best)
        free = {name: amount + held[best].get(name, 0.0) for name, amount in free.items()}
    return tuple(stopped) if _fits(needed, free) else ()
