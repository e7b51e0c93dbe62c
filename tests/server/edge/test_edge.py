"""An origin, an edge before it and an edge before that, each a process."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from contextlib import ExitStack

import httpx
import pytest

from streamlod.codec.sound.beside import sound_beside
from streamlod.core.scene.anchors import Scene
from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip
from tests.server.edge.processes import Node, begin, listening, wait_live
from tests.waiting import wait

pytestmark = pytest.mark.cluster

LINGER_SECONDS = 2.0


@pytest.fixture(scope="module")
def chain(long_clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Node, Node, Node]]:
    """Origin, edge, edge of the edge; streams are let go soon after their last viewer."""
    folder = tmp_path_factory.mktemp("chain")
    with ExitStack() as stack:
        nodes: list[Node] = []
        for number in range(3):
            if number == 0:
                begun = begin(folder, "serve", "--play", long_clip.path)
            else:
                config = folder / f"{number}.toml"
                edge = f'origin = "{nodes[-1].url}"\nlinger_seconds = {LINGER_SECONDS}\npoll_seconds = 0.2\n'
                config.write_text(f"[edge]\n{edge}")
                begun = begin(folder, "serve", "--config", config)
            stack.callback(begun[0].wait)
            stack.callback(begun[0].kill)
            nodes.append(listening(begun))
        wait_live(nodes[0])
        wait(lambda: nodes[2].get("/v1/streams/main").status_code == 200)
        yield nodes[0], nodes[1], nodes[2]


def let_go(origin: Node) -> None:
    wait(lambda: origin.stream()["viewers"] == 0)


def test_two_hops_show_what_the_origin_shows_under_its_positions(
    chain: tuple[Node, Node, Node], long_clip: Clip
) -> None:
    with chain[2].viewing() as viewer:
        viewer.hello()
        viewer.until("caught_up")
        for _ in range(30):
            viewer.next_packet()
        scene: Scene | None = viewer.decoder.scene
        assert scene is not None
        assert_same_state(scene, long_clip.states[scene.version])
        assert viewer.welcome["incarnation"] == chain[0].stream()["incarnation"]


def test_packets_and_groups_are_the_origins_byte_for_byte(chain: tuple[Node, Node, Node]) -> None:
    origin, edge, _ = chain
    with edge.viewing() as viewer:
        viewer.hello()
        viewer.until("caught_up")
        manifest = wait(lambda: (found := edge.get("/v1/streams/main/manifest").json())["gops"][1:] and found)
        group = manifest["gops"][0]
        assert manifest["incarnation"] in group["path"]
        packet = f"/v1/streams/main/incarnations/{manifest['incarnation']}/packets/{group['epoch']}/{group['last']}"
        for path in (group["path"], packet):
            here, there = edge.get(path), origin.get(path)
            assert here.status_code == there.status_code == 200
            assert here.content == there.content
            for header in ("etag", "cache-control", "content-type"):
                assert here.headers[header] == there.headers[header]
            assert "immutable" in here.headers["cache-control"]
            assert edge.get(path, **{"If-None-Match": here.headers["etag"]}).status_code == 304


def test_a_stream_is_pulled_once_and_only_while_somebody_watches(chain: tuple[Node, Node, Node]) -> None:
    origin, edge, _ = chain
    let_go(origin)
    assert edge.stream()["version"] is None
    with ExitStack() as stack:
        for _ in range(5):
            viewer = stack.enter_context(edge.viewing())
            viewer.hello()
            viewer.until("caught_up")
        assert edge.stream()["viewers"] == 5
        assert origin.stream()["viewers"] == 1
        left_at = time.monotonic()
    assert origin.stream()["viewers"] == 1
    let_go(origin)
    assert time.monotonic() - left_at > LINGER_SECONDS
    wait(lambda: edge.stream()["version"] is None)


def test_an_edge_answers_seeks_from_what_it_holds(chain: tuple[Node, Node, Node], long_clip: Clip) -> None:
    edge = chain[1]
    with edge.viewing() as viewer:
        viewer.hello()
        viewer.until("caught_up")
        wait(lambda: viewer.step() and len(viewer.decoder.versions) and viewer.packets > 30)
        oldest = edge.get("/v1/streams/main/manifest").json()["window"]["oldest"]
        to = oldest | {"version": oldest["version"] + 7}
        viewer.send(type="seek", to=to)
        while True:
            event = viewer.until("position")
            if event["mode"] == "replay":
                break
        assert (event["epoch"], event["version"], event["clamped"]) == (to["epoch"], to["version"], False)
        viewer.next_packet()
        assert_same_state(viewer.until_version(to["version"]), long_clip.states[viewer.decoder.versions[0]])


def test_page_and_whole_recording_come_from_the_edge(chain: tuple[Node, Node, Node], long_clip: Clip) -> None:
    edge = chain[2]
    assert "<html" in edge.get("/").text
    whole = edge.get("/v1/streams/main/recording")
    assert hashlib.sha256(whole.content).digest() == hashlib.sha256(long_clip.path.read_bytes()).digest()
    part = edge.get("/v1/streams/main/recording", Range="bytes=100-299")
    assert (part.status_code, part.content) == (206, whole.content[100:300])
    assert part.headers["content-range"] == f"bytes 100-299/{len(whole.content)}"
    etag = whole.headers["etag"]
    assert edge.get("/v1/streams/main/recording", **{"If-None-Match": etag}).status_code == 304
    assert edge.get("/v1/streams/main/recording", Range="bytes=99999999-").status_code == 416


def test_sound_comes_from_the_edge_too(chain: tuple[Node, Node, Node], long_clip: Clip) -> None:
    edge = chain[2]
    assert edge.stream()["sound"] == {"begin_ns": 20_000_000, "channels": 1, "live": False, "camera": None}
    part = edge.get("/v1/streams/main/sound", Range="bytes=100-299")
    assert (part.status_code, part.content) == (206, sound_beside(long_clip.path).read_bytes()[100:300])
    assert part.headers["content-type"] == "audio/ogg"


def test_an_edge_makes_and_controls_nothing(chain: tuple[Node, Node, Node]) -> None:
    with httpx.Client(base_url=chain[1].url, trust_env=False) as client:
        assert client.post("/v1/streams", json={"id": "mine", "play": "x.slod"}).status_code == 405
        assert client.post("/v1/streams/main/stop").status_code in {404, 405}
        assert client.delete("/v1/streams/main").status_code == 405
