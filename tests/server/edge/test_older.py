"""This version beside an older one, as in the middle of an upgrade: servers, edges and viewers in any mixture.

The older one is taken from the history of this repository: the commit that froze version 1 of the bitstream. Its
servers name no edges and do not say when they drain, its manifests lack fields, and its viewers know none of these.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from hashlib import sha256
from pathlib import Path

import pytest

from streamlod.core.scene.anchors import Scene
from tests.server.conftest import Clip
from tests.server.edge.processes import Node, node
from tests.server.ports import free_ports
from tests.waiting import wait

pytestmark = pytest.mark.cluster

OLDER = "c4b60cff6e21cbb1b0771d840b36039af2663c22"
ROOT = Path(__file__).parents[3]
# Watches a stream at one server after another; a line for each scene, with its version and what it holds.
VIEWER = """
import asyncio, json, os, sys
from contextlib import aclosing
from hashlib import sha256
if os.path.isdir("streamlod"):
    from streamlod.client.events import NewScene
    from streamlod.client.connection.watch import watch
else:
    from client.events import NewScene
    from client.connection import watch

def state_hash(scene):
    return sha256(b"".join(bytes(column) for level in scene.levels for column in level.state())).hexdigest()

async def run(port, scenes):
    url = f"ws://127.0.0.1:{port}/v1/streams/main/live"
    async with aclosing(watch(url)) as events:
        async for event in events:
            if isinstance(event, NewScene) and event.levels == len(event.scene.levels):
                print(json.dumps([event.scene.version, state_hash(event.scene)]), flush=True)
                scenes -= 1
                if not scenes:
                    return

for port in sys.argv[2:]:
    asyncio.run(run(port, int(sys.argv[1])))
"""


@pytest.fixture(scope="module")
def older(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The older version's code."""
    command = ["git", "-C", ROOT, "archive", "--format=zip", OLDER, "core", "codec", "server", "client"]
    archive = subprocess.run(command, capture_output=True, check=False)
    if archive.returncode:
        pytest.skip("the history of this repository is not here: git fetch --unshallow")
    folder = tmp_path_factory.mktemp("older")
    with zipfile.ZipFile(io.BytesIO(archive.stdout)) as packed:
        packed.extractall(folder)
    return folder


def version_node(folder: Path, *arguments: object, source: Path, port: int = 0) -> AbstractContextManager[Node]:
    """A process of that version. The older one compiles nothing: that took longer than all that it decodes here."""
    return node(folder, *arguments, source=source, port=port, NUMBA_DISABLE_JIT=str(int(source != ROOT)))


def state_hash(scene: Scene) -> str:
    """As `VIEWER` tells it."""
    return sha256(b"".join(bytes(column) for level in scene.levels for column in level.state())).hexdigest()


def viewer_sees(source: Path, servers: Sequence[Node], clip: Clip, scenes: int = 15) -> None:
    """Run a viewer of that version at each server; what it shows has to be what was filmed."""
    command = [sys.executable, "-c", VIEWER, str(scenes), *(str(server.port) for server in servers)]
    environment = os.environ | {"PYTHONPATH": str(source), "NUMBA_DISABLE_JIT": str(int(source != ROOT))}
    done = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    seen = [json.loads(line) for line in done.stdout.splitlines()]
    for begin in range(0, len(servers) * scenes, scenes):
        assert len({version for version, _ in seen[begin : begin + scenes]}) == scenes
    assert [found for _, found in seen] == [state_hash(clip.states[version]) for version, _ in seen]


def same_groups(one: Node, other: Node) -> bool:
    """Whether what both hold has the same bytes under the same addresses; False while there is nothing to compare."""
    manifest = one.get("/v1/streams/main/manifest").json()
    paths = [group["path"] for group in manifest["gops"][:-1]]
    both = [(one.get(path), other.get(path)) for path in paths]
    assert all((a.status_code, a.content) == (b.status_code, b.content) for a, b in both if a.status_code == 200)
    return bool(both)


@pytest.mark.parametrize("upgraded", ["the origin", "the edge"])
def test_an_origin_and_an_edge_of_two_versions_serve_viewers_of_both(
    older: Path, upgraded: str, long_clip: Clip, tmp_path: Path
) -> None:
    sources = (ROOT, older) if upgraded == "the origin" else (older, ROOT)
    with ExitStack() as stack:
        origin = stack.enter_context(version_node(tmp_path, "serve", "--play", long_clip.path, source=sources[0]))
        edge = stack.enter_context(version_node(tmp_path, "edge", "--origin", origin.url, source=sources[1]))
        wait(lambda: edge.get("/readyz").status_code == 200)
        wait(lambda: edge.get("/v1/streams/main").status_code == 200)
        for source, server in zip(sources, (origin, edge), strict=True):
            assert ("edges" in server.get("/v1/server").json()) == (source == ROOT)  # these are two versions
        for source in (ROOT, older):
            viewer_sees(source, (origin, edge), long_clip)
        with edge.viewing() as viewer:
            viewer.hello().until("caught_up")
            wait(lambda: viewer.step() and same_groups(edge, origin))


@pytest.mark.parametrize("step", ["upgrade", "rollback"])
def test_viewers_of_an_edge_stay_while_the_origin_becomes_another_version(
    older: Path, step: str, slow_long_clip: Clip, tmp_path: Path
) -> None:
    """It goes on from the state folder of the version before, as the next epoch of the same incarnation."""
    before, after = (older, ROOT) if step == "upgrade" else (ROOT, older)
    (port,) = free_ports(1)
    serve = ("serve", "--play", slow_long_clip.path, "--state-dir", tmp_path / "state")
    with ExitStack() as stack:
        origin = stack.enter_context(version_node(tmp_path, *serve, port=port, source=before))
        edge = stack.enter_context(version_node(tmp_path, "edge", "--origin", origin.url, source=before))
        wait(lambda: edge.get("/v1/streams/main").status_code == 200)
        viewer = stack.enter_context(edge.viewing()).hello()
        viewer.until("caught_up")
        origin.process.terminate()
        origin.process.wait(60)
        new = stack.enter_context(version_node(tmp_path, *serve, port=port, source=after))
        assert viewer.until("epoch", 30)["epoch"] == 2
        viewer.next_packet()
        scene = viewer.until_version(60)
        assert state_hash(scene) == state_hash(slow_long_clip.states[scene.version])
        groups = new.get("/v1/streams/main/manifest").json()["gops"]
        recorded = {1, 2} if step == "upgrade" else {2}  # what is played is recorded no more
        assert recorded <= {group["epoch"] for group in groups}
        answers = {group["path"]: new.get(group["path"]).status_code for group in groups}
        assert set(answers.values()) == {200}, answers
