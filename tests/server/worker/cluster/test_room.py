"""Why there is no room for a stream, and what would have to stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from streamlod.server.worker.cluster.room import Amounts, Holding, Shortage, needs, shortage

NODES = {"a": {"CPU": 4.0, "GPU": 1.0, "memory": 1e9}, "b": {"CPU": 8.0}}


def held(holder: str, node: str, cpus: float, gpus: float = 0) -> Holding:
    return Holding(holder, node, needs(cpus, gpus))


def refusal(needed: Amounts, nodes: Mapping[str, Amounts], holdings: Sequence[Holding]) -> str:
    """For somebody who may see all streams."""
    return shortage(needed, nodes, holdings).sentence(lambda _: True)


def test_streams_are_named_to_those_who_may_see_them() -> None:
    full = Shortage("it is full", (("mine",), ("mine", "theirs")))
    assert full.sentence(lambda name: name == "mine") == "it is full; stop mine"
    assert full.sentence(lambda name: name == "theirs") == full.sentence() == (
        "it is full; stop other streams, or add a node"
    )  # fmt: skip
    assert Shortage("it is full").sentence() == "it is full"


def test_no_node_is_large_enough() -> None:
    text = refusal(needs(16, 0.5), NODES, [])
    assert text.startswith("it needs 16 CPU and 0.5 GPU on one node")
    assert "no node is that large" in text


def test_each_stream_that_alone_would_make_room_is_named() -> None:
    taken = [held("left", "a", 1, 0.5), held("right", "a", 1, 0.5), held("far", "b", 8)]
    assert refusal(needs(1, 0.5), NODES, taken).endswith("stop left")  # the far one has no GPU to give
    assert refusal(needs(4, 0), NODES, taken).endswith("stop far, or left and right")


def test_worker_and_spare_of_a_stream_are_one_to_stop() -> None:
    taken = [held("main", "a", 2), held("main", "a", 2), held("far", "b", 8)]
    assert refusal(needs(3, 0), NODES, taken).endswith("stop far, or main")


def test_other_programs_cannot_be_stopped_from_here() -> None:
    assert "other programs hold them" in refusal(needs(2, 0), NODES, [held("", "a", 4), held("", "b", 8)])
    assert "other programs hold them" in refusal(needs(2, 0), NODES, [])  # who take what Ray does not list
    taken = [held("", "a", 3), held("main", "a", 1), held("", "b", 8)]
    assert "other programs hold them" in refusal(needs(2, 0), NODES, taken)


def test_fractions_that_add_up_fit() -> None:
    tenths = [held(f"s{number}", "a", 0.1, 0.1) for number in range(9)]
    assert "other programs" in refusal(needs(0.1, 0.1), {"a": NODES["a"]}, tenths)
    assert refusal(needs(0.1, 0.1), {"a": NODES["a"]}, [*tenths, held("last", "a", 0.1, 0.1)]).endswith("stop last")
