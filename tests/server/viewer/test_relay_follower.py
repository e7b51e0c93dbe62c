"""A viewer that relays gets every packet as it was published."""

from __future__ import annotations

import pytest

import streamlod.server.stream.stream
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.server.conftest import Clip, Viewer, make_clip, running, viewing


def packets_of(viewer: Viewer, count: int) -> list[bytes]:
    """The next packets."""
    found: list[bytes] = []
    while len(found) < count:
        message = viewer.step()
        if isinstance(message, bytes):
            found.append(message)
    return found


def test_packets_come_whole_from_the_newest_keyframe_on(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path, loop=False)) as node:
        node.wait(lambda stream: (stream["version"] or 0) > 65)  # the keyframe of version 60 has come
        with viewing(node, max_queue=None) as viewer:
            viewer.hello(relay=True)
            assert packets_of(viewer, 40) == clip.packets[60:]
            if not viewer.named("caught_up"):  # it came too late to see any of them live
                viewer.until("caught_up")
            assert [event["event"] for event in viewer.events].count("caught_up") == 1


def test_a_relay_that_comes_back_goes_on_with_the_packet_that_it_has(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path, loop=False)) as node:
        node.wait(lambda stream: (stream["version"] or 0) > 65)
        with viewing(node, max_queue=None) as viewer:
            viewer.decoder.push(clip.packets[0])
            for packet in clip.packets[1:30]:
                viewer.decoder.push(packet)
            viewer.hello(relay=True, start={"epoch": 1, "version": 30})
            assert packets_of(viewer, 70) == clip.packets[30:]


@pytest.mark.parametrize("hello", [{"relay": True}, {"start": {"epoch": 1, "version": 0}}], ids=["relay", "replay"])
def test_each_epoch_is_announced_before_its_first_packet(
    hello: dict[str, object], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Also to a viewer that watches the past while new epochs begin."""
    clip = make_clip(tmp_path_factory.mktemp("short") / "scene.slod", 15)
    with (
        running(Settings(), StreamSpec(play=clip.path)) as node,
        viewing(node, max_queue=None) as viewer,
    ):
        node.wait(lambda stream: stream["epoch"] == 2 if "start" in hello else stream["version"] is not None)
        viewer.hello(**hello)
        seen: list[bytes | int] = []
        while len(seen) < 40:
            message = viewer.step()
            if isinstance(message, bytes):
                seen.append(message)
            elif message["event"] == "epoch":
                seen.append(message["epoch"])
        first = seen.index(1)
        assert seen[first + 1 : first + 17] == [*clip.packets, 2]
        assert seen[first + 17 : first + 33] == [*clip.packets, 3]


@pytest.mark.long
def test_a_relay_that_falls_behind_is_told_so_and_begins_with_a_keyframe(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streamlod.server.stream.stream, "_HUB_BYTES", 4000)
    clip = make_clip(tmp_path_factory.mktemp("long") / "scene.slod", 200, key_every=10)
    limits = Settings().limits.model_copy(update={"flight_bytes": 65536})
    with (
        running(Settings(limits=limits), StreamSpec(play=clip.path, loop=False)) as node,
        viewing(node, acknowledge=False, max_queue=None) as viewer,
    ):
        viewer.hello(relay=True)
        viewer.send(type="ack", bytes=0)  # from now on there is a limit to what may be on its way
        viewer.until("caught_up")
        node.wait(lambda stream: stream["version"] == 199)
        received = viewer.received
        while not viewer.named("skipped"):
            viewer.step()
            if viewer.received > received:
                viewer.send(type="ack", bytes=viewer.received)
        rest = packets_of(viewer, 1)
        assert rest[0] in clip.packets[::10]
