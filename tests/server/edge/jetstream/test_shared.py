"""A node that publishes and a node that serves, over one NATS server."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from websockets.exceptions import ConnectionClosed

from streamlod.codec.container import SlodReader
from streamlod.server.edge.jetstream import claim, publisher
from streamlod.server.edge.jetstream.claim import Claim
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import Names
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import MEGABYTE, Retention
from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip, Running, make_clip, running, viewing
from tests.server.edge.jetstream.nats_servers import RETENTION, Nats, nats, needs_nats
from tests.server.edge.jetstream.recorder import packets_in, stored
from tests.server.edge.processes import wait_live
from tests.server.sounds import hear, pieces
from tests.waiting import wait

pytestmark = needs_nats
SMALL_PAYLOAD = 32_768  # bytes


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nats]:
    with nats(tmp_path_factory.mktemp("nats")) as found:
        yield found


@pytest.fixture(scope="module")
def publishing(one: Nats, long_clip: Clip) -> Iterator[Running]:
    with running(one.settings(), StreamSpec(play=long_clip.path, loop=False, id="played")) as server:
        server.wait(lambda stream: stream["state"] == "ended", "played", 30)
        wait_stored(server, "played")
        yield server


def wait_stored(server: Running, name: str = "main") -> None:
    """Until NATS has all that a stream's node has published so far."""
    outbox: Any = server.registry.streams[name].bus.outbox
    wait(lambda: outbox.waiting_bytes == 0)


def stream_limits(shared: Nats, stream: str) -> list[tuple[Any, Any]]:
    """How the JetStream streams of a stream's packets and of descriptions are limited: bytes and seconds."""
    settings = shared.settings().jetstream

    async def run() -> list[tuple[Any, Any]]:
        names, connection = Names(settings.prefix), NatsConnection(settings)
        await connection.open()
        try:
            found = [await connection.jetstream.stream_info(each) for each in (names.packets(stream), names.directory)]
        finally:
            await connection.close()
        return [(each.config.max_bytes, each.config.max_age) for each in found]

    return asyncio.run(asyncio.wait_for(run(), 20))


def serves(server: Running, name: str = "main") -> dict[str, Any]:
    def look() -> Any:
        with server.client() as client:
            answer = client.get(f"/v1/streams/{name}")
            return answer.json() if answer.status_code == 200 else None

    found: dict[str, Any] = wait(look)
    return found


def test_a_node_that_starts_later_serves_the_whole_past_byte_for_byte(
    one: Nats, publishing: Running, long_clip: Clip
) -> None:
    with running(one.settings()) as late, late.client() as here, publishing.client() as there:
        assert serves(late, "played")["incarnation"] == publishing.stream("played")["incarnation"]
        with viewing(late, "played", max_queue=None) as viewer:
            viewer.hello().until("caught_up")
            assert viewer.until_version(399).version == 399
            window = viewer.named("window")[-1] if viewer.named("window") else viewer.welcome["window"]
            viewer.send(type="seek", to={"epoch": 1, "version": 60})
            place = viewer.until("position")
            assert (place["version"], place["clamped"], place["mode"]) == (60, False, "replay")
            while viewer.decoder.scene is None or viewer.decoder.scene.version != 60:
                viewer.step()
            assert_same_state(viewer.decoder.scene, long_clip.states[60])
            manifest = here.get("/v1/streams/played/manifest").json()
            assert manifest["window"]["oldest"] == {"epoch": 1, "version": 0}, window
            original = there.get("/v1/streams/played/manifest").json()
            for mine, theirs in zip(manifest["gops"], original["gops"], strict=True):
                untimed = dict.fromkeys(("begun_ns", "first_time_ns", "last_time_ns"))  # NATS keeps no times of filming
                assert mine | untimed == theirs | untimed
                assert here.get(mine["path"]).content == there.get(mine["path"]).content
            path = manifest["gops"][1]["path"].replace("gops/1/50", "packets/1/77")
            assert here.get(path).content == long_clip.packets[77] == there.get(path).content
            begun = datetime.fromtimestamp(manifest["gops"][3]["begun_ns"] / 1e9, UTC)
            part = here.get("/v1/streams/played/bitstream", params={"from": begun.isoformat()})
            assert part.status_code == 200
            assert part.content.count(long_clip.packets[200]) == 1
            assert long_clip.packets[60] not in part.content


def test_live_sound_reaches_viewers_of_other_nodes_and_is_stored_once(one: Nats, slow_clip: Clip) -> None:
    """What is heard before anybody watches there, as it belongs to pictures to come, and what comes later."""
    settings, told = one.settings(), pieces(12.0)
    with running(settings, StreamSpec(play=slow_clip.path, id="heard")) as there, running(settings) as here:
        hear(there, told[:30], "heard")
        wait(lambda: serves(here, "heard")["sound"])
        with viewing(here, "heard", max_queue=None) as viewer:
            assert viewer.hello(sound=True).welcome["sound"] == {
                "begin_ns": 0,
                "channels": 1,
                "live": True,
                "camera": None,
            }
            viewer.until_heard(told[29].end_ns - 1)
            hear(there, told[30:], "heard")
            viewer.until_heard(told[-1].end_ns - 1)
            heard = [piece for piece in told if piece.begin_ns >= viewer.sound[0].begin_ns]
            assert viewer.sound == heard
            assert told[1:] == heard[-len(told[1:]) :]
        with here.client() as client:
            assert client.get("/v1/streams/heard/sound?from_ns=6000000000").headers["content-type"] == "audio/ogg"
            wait(lambda: client.get("/v1/streams/heard/manifest").json()["gops"])  # sound among packets is no packet


def test_live_sound_from_before_nats_was_reached_is_published(tmp_path: Path, slow_clip: Clip) -> None:
    told = pieces(6.0)
    with nats(tmp_path) as late:
        (server,) = late.servers
        server.kill()
        with running(late.settings(), StreamSpec(play=slow_clip.path, id="heard")) as there:
            hear(there, told, "heard")
            server.start()
            with running(late.settings()) as here:
                wait(lambda: serves(here, "heard")["sound"])
                with viewing(here, "heard", max_queue=None) as viewer:
                    viewer.hello(sound=True).until_heard(told[-1].end_ns - 1)


def test_what_is_stored_is_each_packet_once(one: Nats, publishing: Running, long_clip: Clip) -> None:
    messages = stored(one.settings(), "played")
    assert packets_in(messages) == long_clip.packets
    assert len({name for name, _ in messages}) == len(messages)


def test_viewers_of_two_nodes_see_the_same_live(one: Nats, long_clip: Clip) -> None:
    with running(one.settings(), StreamSpec(play=long_clip.path)) as server, running(one.settings()) as other:
        serves(other)
        with viewing(server, max_queue=None) as near, viewing(other, max_queue=None) as far:
            for viewer in (near, far):
                viewer.hello().until("caught_up")
            version = near.until_version(60).version
            assert_same_state(far.until_version(version), long_clip.states[max(far.decoder.versions)])
            wait_live(other)
            with server.client() as client:
                assert client.delete("/v1/streams/main").status_code == 204
            with pytest.raises(ConnectionClosed, match="1000"):
                far.until("nothing that it sends")
        wait(lambda: "main" not in other.registry.streams)


def test_large_keyframes_travel_in_pieces(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "large.slod", 4, (10, 40, 40_000), key_every=2)
    assert len(clip.packets[2]) > 4 * SMALL_PAYLOAD
    spec = StreamSpec(play=clip.path, loop=False, id="large")
    with (
        nats(tmp_path / "nats", more=f"max_payload: {SMALL_PAYLOAD}\n") as small,
        running(small.settings(), spec) as server,
        running(small.settings()) as other,
    ):
        server.wait(lambda stream: stream["state"] == "ended", "large")
        serves(other, "large")
        with viewing(other, "large", max_queue=None) as viewer:
            viewer.hello()
            assert_same_state(viewer.until_version(3), clip.states[3])
            with other.client() as client:
                group = client.get("/v1/streams/large/manifest").json()["gops"][0]
                assert group["bytes"] == len(clip.packets[0]) + len(clip.packets[1])
                (tmp_path / "group.slod").write_bytes(client.get(group["path"]).content)
            wait_stored(server, "large")
            pieces = [len(body) for _, body in stored(small.settings(), "large")]
            assert max(pieces) < SMALL_PAYLOAD < sum(pieces) == sum(map(len, clip.packets))
        with SlodReader(tmp_path / "group.slod") as reader:
            assert [reader.read(number) for number in range(2)] == clip.packets[:2]


def test_a_stream_that_is_published_by_another_version_of_the_protocol_is_left_out(
    one: Nats, publishing: Running, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    settings = one.settings()

    async def tell(description: dict[str, Any]) -> None:
        connection = NatsConnection(settings.jetstream)
        await connection.open()
        try:
            assert await Claim(connection, Names(settings.jetstream.prefix), description["id"]).tell(description)
        finally:
            await connection.close()

    described = publishing.stream("played")
    asyncio.run(asyncio.wait_for(tell(described | {"id": "plain", "news": "which nobody knows"}), 20))
    monkeypatch.setattr(claim, "PROTOCOL_VERSION", 2)
    asyncio.run(asyncio.wait_for(tell(described | {"id": "later"}), 20))
    monkeypatch.undo()
    with running(settings) as server:
        serves(server, "plain")
        wait(lambda: "stream later: its description in JetStream cannot be used" in caplog.text)
        assert "(version 2 of the protocol, not 1)" in caplog.text
        assert "later" not in server.registry.streams


def test_of_two_nodes_with_one_stream_one_publishes(
    one: Nats, clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "SILENT_SECONDS", 0.2)  # the second one gives up sooner
    spec = StreamSpec(play=clip.path, id="twice")
    other = one.settings().model_copy(update={"retention": Retention(bytes=RETENTION.bytes // 2, seconds=60)})
    with running(one.settings(), spec) as first:
        first.wait(lambda stream: stream["state"] == "live", "twice")
        wait(lambda: stored(one.settings(), "twice"))
        limits = stream_limits(one, "twice")
        with running(other, spec) as second:
            second.wait(lambda stream: stream["state"] == "live", "twice")
            time.sleep(2.5)
            wait_stored(second, "twice")
            outbox: Any = second.registry.streams["twice"].bus.outbox
            assert outbox.lost_packets == 0
            assert stream_limits(one, "twice") == limits
            found = {name.split("/")[0] for name, _ in stored(one.settings(), "twice")}
            assert found == {first.stream("twice")["incarnation"]}


def test_without_nats_a_node_serves_its_own_viewers_and_keeps_a_bounded_queue(tmp_path: Path, long_clip: Clip) -> None:
    retention = Retention(bytes=RETENTION.bytes, memory_bytes=MEGABYTE)
    large = make_clip(tmp_path / "clip.slod", 150, (10, 40, 6000), key_every=25)
    assert sum(map(len, large.packets)) > 1.4 * MEGABYTE
    with nats(tmp_path / "nats") as away:
        away.servers[0].kill()
        settings = away.settings().model_copy(update={"retention": retention})
        with running(settings, StreamSpec(play=large.path, loop=False)) as server:
            with viewing(server, max_queue=None) as viewer:
                viewer.hello()
                assert_same_state(viewer.until_version(120), large.states[max(viewer.decoder.versions)])
            server.wait(lambda stream: stream["state"] == "ended")
            outbox: Any = server.registry.streams["main"].bus.outbox
            assert outbox.waiting_bytes <= MEGABYTE
            assert outbox.lost_packets > 0
            away.servers[0].start()
            away.servers[0].wait()
            wait_stored(server)
            packets = packets_in(stored(settings))
            assert packets
            begin = large.packets.index(packets[0])
            assert begin % 25 == 0  # a keyframe
            assert packets == large.packets[begin : begin + len(packets)]


def test_nats_loses_its_disk(tmp_path: Path, long_clip: Clip) -> None:
    """What was stored is gone; both nodes begin again with an empty NATS server, without being started again."""
    with (
        nats(tmp_path / "nats") as shared,
        running(shared.settings(), StreamSpec(play=long_clip.path)) as server,
        running(shared.settings()) as other,
    ):
        serves(other)
        with viewing(other, max_queue=None) as viewer:
            viewer.hello().until_version(60)
            shared.servers[0].kill()
            with other.client() as client:
                answer = client.get("/v1/streams/main/bitstream")
                assert (answer.status_code, answer.headers["retry-after"]) == (503, "2")
            shutil.rmtree(shared.servers[0].folder)
            shared.servers[0].start()
            shared.servers[0].wait()
            before = other.stream()

        def goes_on() -> bool:
            """Whether pictures come again; a viewer may be closed with 1001 once, to begin anew."""
            with suppress(ConnectionClosed, TimeoutError), viewing(other, max_queue=None) as again:
                again.hello().until("caught_up")
                for _ in range(20):
                    again.next_packet()
                return True
            return False

        wait(goes_on, 30)
        after = other.stream()
        assert (after["epoch"], after["version"]) > (before["epoch"], before["version"])
        assert after["incarnation"] == server.stream()["incarnation"]


def test_the_permissions_of_the_documents_are_enough(
    tmp_path: Path, clip: Clip, caplog: pytest.LogCaptureFixture
) -> None:
    allowed = '{publish: ["streamlod.>", "$JS.API.>"], subscribe: ["_INBOX.>"]}'
    user = f"{{user: server, password: none, permissions: {allowed}}}"
    with nats(tmp_path, more=f"authorization {{users: [{user}]}}\nno_auth_user: server\n") as closed:
        spec = StreamSpec(play=clip.path, loop=False)
        with running(closed.settings(), spec) as server, running(closed.settings()) as other:
            server.wait(lambda stream: stream["state"] == "ended")
            serves(other)
            with viewing(other, max_queue=None) as viewer, other.client() as client:
                viewer.hello().until("caught_up")
                assert viewer.until_version(len(clip.packets) - 1).version == len(clip.packets) - 1
                manifest = client.get("/v1/streams/main/manifest").json()
                assert client.get(manifest["gops"][0]["path"]).status_code == 200
            with server.client() as client:
                assert client.delete("/v1/streams/main").status_code == 204
            wait(lambda: "main" not in other.registry.streams)
    assert not [line for line in caplog.messages if "ermission" in line]
