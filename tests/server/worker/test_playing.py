"""A recorded file as a worker plays it: packet by packet, damaged, written over."""

from __future__ import annotations

import multiprocessing
import time
from pathlib import Path

import pytest

from streamlod.codec.container import SlodWriter
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.worker.messages import Resume, Sender, Tag
from streamlod.server.worker.playing import play
from tests.server.conftest import Clip, make_clip, running


class Collector:
    """Stands in for a pipe that somebody empties."""

    def __init__(self) -> None:
        self.messages: list[tuple[Tag, object]] = []

    def __call__(self, tag: Tag, body: object = b"") -> None:
        self.messages.append((tag, body))


def received(clip: Clip, resume: Resume) -> list[tuple[Tag, bytes]]:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    messages = []
    with ours, theirs:
        play(StreamSpec(play=clip.path, loop=False), resume, Sender(theirs))
        while ours.poll():
            data = ours.recv_bytes()
            messages.append((Tag(data[0]), data[1:]))
    return messages


def test_nobody_waits_where_nothing_was_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of an evening in which the phones were away for ten minutes, and again."""
    monkeypatch.setattr("streamlod.server.worker.playing.MAX_GAP_SECONDS", 0.3)
    clip = make_clip(tmp_path / "gaps.slod", 3, counts=(5, 10), frame_ns=600 * 10**9)
    begin = time.monotonic()
    assert len([tag for tag, _ in received(clip, Resume()) if tag is Tag.PACKET]) == 3
    assert 0.6 <= time.monotonic() - begin < 60


def test_a_file_is_played_packet_by_packet(clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    monkeypatch.setattr("streamlod.server.worker.messages.Sender.send", collect := Collector())
    received(clip, Resume())
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == clip.packets
    collect.messages.clear()
    received(clip, Resume(frames=75))
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == clip.packets[60:]


def damage(clip: Clip, *versions: int) -> None:
    """Change a byte in the middle of the packets of these versions."""
    data = bytearray(clip.path.read_bytes())
    for version in versions:
        at = data.index(clip.packets[version]) + len(clip.packets[version]) // 2
        data[at] ^= 1
    clip.path.write_bytes(data)


def test_what_is_damaged_of_a_file_is_left_out_up_to_the_next_keyframe(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = make_clip(tmp_path / "clip.slod", 9, counts=(5, 10), key_every=3, frame_ns=1)
    damage(clip, 1, 6)
    monkeypatch.setattr("streamlod.server.worker.messages.Sender.send", collect := Collector())
    received(clip, Resume())
    assert [body for tag, body in collect.messages if tag is Tag.PACKET] == [clip.packets[n] for n in (0, 3, 4, 5)]
    left_out = [record.getMessage() for record in caplog.records]
    assert [line.split(": ")[1] for line in left_out] == [
        f"left out from frame {n} up to the next keyframe" for n in (1, 6)
    ]


@pytest.mark.parametrize("frames", [3, 12])
def test_a_file_that_is_written_over_while_it_is_played_follows_at_the_next_round(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    clip = make_clip(tmp_path / "clip.slod", 6, counts=(5, 10), key_every=3, frame_ns=1)
    other = make_clip(tmp_path / "other.slod", frames, counts=(10, 20), key_every=3, frame_ns=1)
    monkeypatch.setattr("streamlod.server.worker.playing.MAX_GAP_SECONDS", 0.0)
    rounds: list[list[bytes]] = [[]]

    def send(_: Sender, tag: Tag, body: bytes = b"") -> None:
        if tag is Tag.PACKET:
            rounds[-1].append(body)
        if tag is Tag.EPOCH:
            if len(rounds) == 2:
                raise ConnectionResetError
            rounds.append([])
            clip.path.write_bytes(other.path.read_bytes())

    monkeypatch.setattr("streamlod.server.worker.messages.Sender.send", send)
    with pytest.raises(ConnectionResetError):
        play(StreamSpec(play=clip.path), Resume(), Sender(multiprocessing.Pipe()[1]))
    assert rounds == [clip.packets, other.packets]


def test_a_file_of_which_nothing_is_whole_fails_with_a_sentence_and_is_not_tried_again(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "clip.slod", 3, counts=(5, 10))
    damage(clip, 0)
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
    assert found["restarts"] == 0
    assert found["detail"] == f"{clip.path}: is damaged: none of its keyframes is whole"


@pytest.mark.parametrize("places", [(0, 3), (0, 1, 2)])  # a change of another keyframe, and a version that was before
def test_a_file_whose_packets_do_not_belong_together_is_not_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, places: tuple[int, ...]
) -> None:
    one, other = (make_clip(tmp_path / f"{n}.slod", 2, counts=(5, n)) for n in (10, 20))
    mixed, packets = tmp_path / "mixed.slod", one.packets + other.packets
    with SlodWriter(mixed) as writer:
        for place in places:
            writer.append(packets[place])
    with running(Settings(), StreamSpec(play=mixed)) as server:
        found = server.wait(lambda stream: stream["state"] == "failed")
    assert found["restarts"] == 0
    assert found["detail"].startswith(f"{mixed} cannot be decoded (")
    assert not [record for record in caplog.records if record.exc_info]
