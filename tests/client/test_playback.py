"""The viewer protocol without a socket."""

from __future__ import annotations

import json
from typing import Any

import pytest

from streamlod.client.events import NewScene, Notice, Welcome
from streamlod.client.playback import Playback
from streamlod.codec.packet.levels import drop_levels, split_levels
from streamlod.core.errors import SessionError
from tests.client.clips import packets, states
from tests.codec.scenes import assert_same_state

WELCOME = {
    "type": "welcome",
    "version": 1,
    "session": "s",
    "stream": "main",
    "state": "live",
    "epoch": 3,
    "levels": 3,
    "fps": 30.0,
    "ack_every": 2,
    "news": "unknown fields are ignored",
}


def welcomed(**changes: Any) -> Playback:
    playback = Playback()
    playback.receive_text(json.dumps({**WELCOME, **changes}))
    return playback


@pytest.mark.parametrize("version", [2, None, "1"])
def test_a_server_of_another_version_is_refused_with_what_it_speaks(version: Any) -> None:
    with pytest.raises(SessionError, match=f"the server speaks protocol version {version!r}, not 1") as refused:
        welcomed(version=version)
    assert refused.value.close_code == 4415


def test_hello_says_where_to_start() -> None:
    live = json.loads(Playback().hello())
    assert (live["type"], live["versions"], live["start"]) == ("hello", [1], "live")
    assert "levels" not in live
    message = json.loads(Playback().hello((2, 40), levels=3))
    assert message["start"] == {"epoch": 2, "version": 40}
    assert message["levels"] == 3


def test_welcome_and_packets_become_scenes() -> None:
    playback, scenes = Playback(), states(4)
    assert playback.receive_text(json.dumps(WELCOME)) == [Welcome("main", "live", 3, 3, 30.0)]
    for scene, packet in zip(scenes, packets(scenes), strict=True):
        (event,) = playback.receive_packet(packet, 0.0)
        assert isinstance(event, NewScene)
        assert_same_state(scene, event.scene)
        assert event.levels == 3
    assert playback.position == (3, 3)


def test_a_stream_without_a_keyframe_has_no_epoch_yet() -> None:
    playback = welcomed(epoch=None, levels=None, fps=None, state="starting")
    playback.receive_text('{"type":"event","event":"epoch","epoch":7}')
    playback.receive_packet(packets(states(1))[0], 0.0)
    assert playback.position == (7, 0)


def test_a_keyframe_in_parts_shows_more_and_more_levels() -> None:
    playback, scenes = welcomed(), states(2)
    key, residual = packets(scenes)
    shown = [event.levels for part in split_levels(key) for event in scenes_of(playback, part)]
    assert shown == [1, 2, 3]
    assert [event.levels for event in scenes_of(playback, drop_levels(residual, 1))] == [2]


def scenes_of(playback: Playback, packet: bytes) -> list[NewScene]:
    return [event for event in playback.receive_packet(packet, 0.0) if isinstance(event, NewScene)]


def test_acknowledgements_come_by_count_and_by_time() -> None:
    playback, data = welcomed(), packets(states(4))
    assert playback.acknowledgement(100.0) is None
    playback.receive_packet(data[0], 100.0)
    assert playback.acknowledgement(100.0) is None
    playback.receive_packet(data[1], 100.1)
    first = json.loads(playback.acknowledgement(100.1) or "")
    assert first == {"type": "ack", "bytes": len(data[0]) + len(data[1]), "epoch": 3, "version": 1}
    assert playback.acknowledgement(200.0) is None
    playback.receive_packet(data[2], 200.0)
    assert json.loads(playback.acknowledgement(201.5) or "")["bytes"] == sum(map(len, data[:3]))


def test_events_are_told_and_unknown_ones_ignored() -> None:
    playback = welcomed()
    (notice,) = playback.receive_text('{"type":"event","event":"epoch","epoch":4}')
    assert notice == Notice("epoch", {"epoch": 4})
    playback.receive_packet(packets(states(1))[0], 0.0)
    assert playback.position == (4, 0)
    (notice,) = playback.receive_text('{"type":"event","event":"position","mode":"replay","epoch":4,"version":2}')
    assert playback.mode == "replay"
    assert playback.receive_text('{"type":"event","event":"confetti"}') == []
    assert playback.receive_text('{"type":"gossip"}') == []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"type":1}',
        "[" * 50_000,
        "x" * 70_000,
        json.dumps({**WELCOME, "version": 2}),
        json.dumps({**WELCOME, "epoch": -1}),
        json.dumps({**WELCOME, "ack_every": "often"}),
        json.dumps({**WELCOME, "epoch": True}),
    ],
)
def test_malformed_control_messages_are_refused(text: str) -> None:
    with pytest.raises(SessionError):
        Playback().receive_text(text)


def test_packets_that_do_not_fit_are_refused_and_change_nothing() -> None:
    playback, data = welcomed(), packets(states(4))
    with pytest.raises(SessionError, match="before the welcome"):
        Playback().receive_packet(data[0], 0.0)
    playback.receive_packet(data[0], 0.0)
    for bad in (data[2], data[1][:-1], b"", b"\0" * 100):
        with pytest.raises(SessionError, match="refused") as caught:
            playback.receive_packet(bad, 0.0)
        assert caught.value.close_code == 4400
        assert len(caught.value.detail.encode()) <= 123
    (event,) = scenes_of(playback, data[1])
    assert event.scene.version == 1
