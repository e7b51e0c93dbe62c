"""Every process is killed in mid-stream: nothing that was acknowledged is lost, and nothing is served twice."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.server.edge.jetstream.messages import Names, parse_id
from streamlod.server.protocol.packets import Position
from tests.server.conftest import Clip
from tests.server.edge.jetstream.nats_servers import Nats, nats, needs_nats
from tests.server.edge.jetstream.recorder import packets_in, recording, stored, waiting_bytes
from tests.server.edge.processes import Node, begin, listening, wait_live
from tests.server.ports import held_ports
from tests.waiting import wait

pytestmark = needs_nats


@dataclass(slots=True)
class Nodes:
    """A node that publishes, a node that serves, and the NATS servers between them."""

    folder: Path
    shared: Nats
    publishing: Node
    serving: Node
    publish: tuple[object, ...]
    serve: tuple[object, ...]


@pytest.fixture(scope="module", params=[1, 3], ids=["one NATS server", "a cluster of three"])
def nodes(request: pytest.FixtureRequest, long_clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    folder = tmp_path_factory.mktemp("nodes")
    with ExitStack() as stack:
        shared = stack.enter_context(nats(folder / "nats", request.param))
        config = shared.config(folder / "shared.toml")
        publish = ("serve", "--play", long_clip.path, "--state-dir", folder / "state", "--config", config)
        serve = ("serve", "--config", config)
        ports = stack.enter_context(held_ports(2))  # which they have again when they come back
        begun = [begin(folder, *publish, port=ports[0]), begin(folder, *serve, port=ports[1])]
        found = Nodes(folder, shared, listening(begun[0]), listening(begun[1]), publish, serve)
        stack.callback(lambda: [each.kill() for each in (found.publishing, found.serving)])
        wait_live(found.publishing)
        wait_live(found.serving)  # told by JetStream: without it, that would stay "starting"
        yield found


def keeps_coming(packets: list[bytes], count: int = 30) -> None:
    """Wait for further packets."""
    had = len(packets)
    wait(lambda: len(packets) >= had + count)


def newest(server: Node) -> Position:
    """The newest position of a stream at this server."""
    told = server.stream()
    return Position(told["epoch"], told["version"])


def stored_beyond(place: Position, nodes: Nodes) -> list[tuple[str, bytes]]:
    """What is stored, once something after `place` is; packets keep coming, so that some may wait at any time."""
    messages = stored(nodes.shared.settings())
    last = parse_id(messages[-1][0]) if messages else None
    return messages if last is not None and last.position > place else []


def check_all_came(nodes: Nodes, published: list[bytes], served: list[bytes]) -> None:
    """Both recordings are a part of what is stored, without a hole; the clip's packets recur, so places do, too."""
    messages = wait(partial(stored_beyond, newest(nodes.publishing), nodes), 60)
    assert len({name for name, _ in messages}) == len(messages)
    packets = packets_in(messages)
    for seen in (published, served):
        places = [at for at, packet in enumerate(packets) if packet == seen[0]]
        assert any(packets[at : at + len(seen)] == seen for at in places), (len(seen), len(packets))


def test_a_nats_server_is_killed_and_comes_back(nodes: Nodes) -> None:
    """Of three servers it is the one that leads the stream; what the viewers of the two nodes got is compared."""
    published: list[bytes] = []
    served: list[bytes] = []
    with recording(nodes.publishing.port, published), recording(nodes.serving.port, served):
        keeps_coming(served)
        shared = nodes.shared
        victim = shared.servers[0] if len(shared.servers) == 1 else shared.leader(Names("streamlod").packets("main"))
        victim.kill()
        if len(shared.servers) == 1:
            time.sleep(0.7)
        else:
            keeps_coming(served)  # once the others have elected a leader
        victim.start()
        victim.wait()
        keeps_coming(served)
        wait(lambda: served[-1] in published[-100:])
    check_all_came(nodes, published, served)
    wait_live(nodes.serving)


def test_the_node_that_serves_is_killed_and_comes_back(nodes: Nodes) -> None:
    published: list[bytes] = []
    before: list[bytes] = []
    after: list[bytes] = []
    with recording(nodes.publishing.port, published):
        with recording(nodes.serving.port, before):
            keeps_coming(before)
            port = nodes.serving.port
            nodes.serving.kill()
        nodes.serving = listening(begin(nodes.folder, *nodes.serve, port=port))
        wait(lambda: nodes.serving.get("/v1/streams/main").status_code == 200)
        with recording(port, after):
            keeps_coming(after)
    check_all_came(nodes, before, after)
    check_all_came(nodes, published, published)


def test_the_node_that_publishes_is_killed_and_comes_back(nodes: Nodes) -> None:
    """It goes on with the next epoch of the same incarnation, and viewers stay connected."""
    served: list[bytes] = []
    with recording(nodes.serving.port, served) as viewer:
        keeps_coming(served)
        incarnation, port = nodes.publishing.stream()["incarnation"], nodes.publishing.port
        wait(lambda: waiting_bytes(nodes.publishing) == 0, 60)
        nodes.publishing.kill()
        nodes.publishing = listening(begin(nodes.folder, *nodes.publish, port=port))
        wait_live(nodes.publishing)
        epoch = nodes.publishing.stream()["epoch"]
        wait(lambda: epoch in [told["epoch"] for told in viewer.named("epoch")])
        keeps_coming(served)
        assert nodes.serving.stream()["incarnation"] == incarnation == viewer.welcome["incarnation"]
    check_all_came(nodes, served, served)
    nodes.publishing.kill()
    wait(lambda: "nothing" in nodes.serving.stream()["detail"], 10)
    assert nodes.serving.stream()["state"] == "degraded"
