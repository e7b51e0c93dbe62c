"""Recordings: written packets survive a restart, incomplete files are repaired, retention deletes old ones."""

from __future__ import annotations

import asyncio
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from streamlod.codec.container import SlodReader
from streamlod.codec.packet.info import peek
from streamlod.codec.sound.beside import sound_beside
from streamlod.core.errors import InputError
from streamlod.server.protocol.packets import Position, StreamPacket, stream_packet
from streamlod.server.settings import Retention
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.recording.disk import Disk
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.recording.store import Store
from streamlod.server.stream.sound_track import SoundTrack
from tests.server.conftest import make_clip
from tests.server.sounds import pieces


def packets_of(tmp_path: Path, frames: int = 12, key_every: int = 4) -> list[StreamPacket]:
    clip = make_clip(tmp_path / "source.slod", frames, (4, 8, 16), key_every)
    return [stream_packet(number, 1, data) for number, data in enumerate(clip.packets)]


def record(
    folder: Path, packets: list[StreamPacket], *, close: bool = True, sounding: float = 0.0, **retention: Any
) -> list[str]:
    """Record packets, and `sounding` seconds of sound with each keyframe; names of the segments afterwards."""

    async def run() -> list[str]:
        store = Store(folder, Retention.model_construct(**{**Retention().model_dump(), **retention}))
        recording = store.recording("main")
        for packet in packets:
            recording.append(packet)
            if packet.is_key and sounding:
                recording.append_sound(pieces(sounding), None)
        await recording.flush()
        if not close:  # what a kill leaves behind
            shutil.copytree(folder, folder.with_name("torn"))
        await recording.close()
        names = [segment.path.name for segment in recording.segments]
        store.close()
        return names

    return asyncio.run(run())


def reopened(folder: Path) -> Recording:
    store = Store(folder, Retention())
    recording = store.recording("main")
    store.close()
    return recording


def stored(recording: Recording) -> list[bytes]:
    found = []
    for segment in recording.segments:
        with SlodReader(segment.path) as reader:
            found += list(reader.packets())
    return found


def test_a_recording_is_found_again(tmp_path: Path) -> None:
    packets = packets_of(tmp_path)
    names = record(tmp_path / "state", packets)
    assert names == ["000001-0000000000.slod", "000001-0000000004.slod", "000001-0000000008.slod"]
    recording = reopened(tmp_path / "state")
    assert [s.closed for s in recording.segments] == [True] * 3
    assert stored(recording) == [packet.data for packet in packets]
    assert recording.last_epoch == 1


def test_the_sound_of_a_recording_that_is_found_again_is_offered(tmp_path: Path) -> None:
    """Before anything is heard anew: else the past of an evening would be silent on the next day."""
    record(tmp_path, packets_of(tmp_path), sounding=1.0)
    (tmp_path / "streams" / "main" / sound_beside(Path("000001-0000000000.slod"))).unlink()
    found = SoundTrack(reopened(tmp_path))
    assert found.facts == {"begin_ns": 0, "channels": 1, "live": True, "camera": None}
    assert asyncio.run(found.read(0))
    assert SoundTrack(reopened(tmp_path / "other")).facts is None


@pytest.mark.parametrize("cut", [1, 10, 200, 700])
def test_a_torn_tail_is_cut_and_everything_before_it_stays(tmp_path: Path, cut: int) -> None:
    packets = packets_of(tmp_path)
    record(tmp_path / "state", packets, close=False)
    path = max((tmp_path / "torn").rglob("*.slod"))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - cut])
    found = stored(reopened(tmp_path / "torn"))
    assert found == [packet.data for packet in packets][: len(found)]
    assert len(found) >= 8
    again = reopened(tmp_path / "torn")
    assert stored(again) == found
    assert all(segment.closed for segment in again.segments)


def test_a_segment_without_a_whole_keyframe_is_deleted(tmp_path: Path) -> None:
    record(tmp_path / "state", packets_of(tmp_path))
    path = max((tmp_path / "state").rglob("*.slod"))
    path.write_bytes(path.read_bytes()[:60])
    assert len(reopened(tmp_path / "state").segments) == 2
    assert not path.exists()


def test_groups_of_an_earlier_run_are_as_old_as_they_were(tmp_path: Path) -> None:
    """A file's time is that of its last packet; its packets tell how long before it the first group began."""
    packets = packets_of(tmp_path)
    record(tmp_path / "state", packets)
    first = min((tmp_path / "state").rglob("*.slod"))
    hour_ago = time.time_ns() - 3600 * 10**9
    os.utime(first, ns=(hour_ago, hour_ago))
    lasted = peek(packets[3].data).time_ns - peek(packets[0].data).time_ns
    segments = reopened(tmp_path / "state").segments
    assert segments[0].begun_ns == hour_ago - lasted
    assert segments[1].begun_ns == hour_ago
    assert 3590 < segments[2].begun - segments[0].begun < 3700


def test_later_groups_that_were_made_slower_than_they_were_filmed_begin_when_they_began(tmp_path: Path) -> None:
    """As those of a training: a second was filmed, and took an hour."""
    folder = tmp_path / "state"
    record(folder, packets_of(tmp_path))
    now, hour = time.time_ns(), 3600 * 10**9
    for hours, path in enumerate(sorted(folder.rglob("*.slod"))):
        os.utime(path, ns=(now + hours * hour,) * 2)
    _, second, third = (segment.begun_ns for segment in reopened(folder).segments)
    assert (second, third) == (now, now + hour)


def test_retention_by_bytes_and_age_keeps_the_newest(tmp_path: Path) -> None:
    packets = packets_of(tmp_path)
    assert len(record(tmp_path / "bytes", packets, bytes=1)) == 2  # the newest two at the last keyframe
    assert len(record(tmp_path / "age", packets, seconds=1e-9)) == 1


def test_retention_by_bytes_counts_and_deletes_the_sound_beside(tmp_path: Path) -> None:
    """Room for the pictures of all groups but not for their sound; the sound of an earlier run counts as well."""
    packets = packets_of(tmp_path, frames=16)
    pictures = sum(len(packet.data) for packet in packets)
    folder = tmp_path / "state" / "streams" / "main"
    names = record(tmp_path / "state", packets[:8], sounding=30.0)
    assert sorted(path.name for path in folder.glob("*.opus")) == [f"{name}.opus" for name in names]
    sound = min(path.stat().st_size for path in folder.glob("*.opus"))
    assert sound > 2 * pictures
    names = record(tmp_path / "state", packets[8:], sounding=30.0, bytes=pictures + int(1.5 * sound))
    assert names == ["000001-0000000008.slod", "000001-0000000012.slod"]  # when the last began, one fitted beside none
    assert sorted(path.name for path in folder.glob("*.slod*")) == sorted([*names, *(f"{name}.opus" for name in names)])


def test_a_full_disk_stops_the_recording_and_the_next_keyframe_tries_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    packets = packets_of(tmp_path)

    async def run() -> None:
        store = Store(tmp_path / "state", Retention())
        recording = store.recording("main")
        usage: Callable[[Any], Any] = lambda _: shutil._ntuple_diskusage(100, 99, 1)  # type: ignore[attr-defined]  # noqa: E731
        with monkeypatch.context() as patch:
            patch.setattr(shutil, "disk_usage", usage)
            for packet in packets[:8]:  # two keyframes
                recording.append(packet)
            await recording.flush()
        assert recording.fault is not None
        assert "reserve" in recording.fault
        assert recording.lost_packets == 8
        for packet in packets[8:]:
            recording.append(packet)
        await recording.flush()
        assert recording.fault is None
        assert [s.first for s in recording.segments] == [Position(1, 8)]
        store.close()

    asyncio.run(run())
    assert [record.getMessage() for record in caplog.records] == [
        "stream main: recording stopped: the disk is full except for its reserve",
        "stream main: is recorded again; 8 packets are lost so far",
    ]


def test_a_disk_that_is_too_slow_is_told_of_until_the_next_keyframe(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    packets, stands = packets_of(tmp_path), threading.Event()

    async def run() -> None:
        disk = Disk(tmp_path, Retention.model_construct(**{**Retention().model_dump(), "memory_bytes": 1}))
        standing = asyncio.ensure_future(disk.run(stands.wait))
        await asyncio.sleep(0)  # the disk's thread has it first
        recording = Recording(disk, "main")
        for packet in packets[:3]:  # a keyframe waits, which is too much for the next ones
            recording.append(packet)
        stands.set()
        await standing
        faults = []
        for packet in packets[3:8]:
            await recording.flush()
            faults.append(recording.fault)
            recording.append(packet)
        await recording.flush()
        assert faults == ["the disk is too slow", "the disk is too slow", None, None, None]
        assert [(s.first.version, s.last.version) for s in recording.segments] == [(0, 0), (4, 7)]
        assert recording.lost_packets == 3
        await recording.close()
        disk.close()

    asyncio.run(run())
    assert [record.getMessage() for record in caplog.records] == [
        "stream main: the disk is too slow",
        "stream main: is recorded again; 3 packets are lost so far",
    ]


def test_a_folder_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="state-dir"):
        Store(tmp_path / "file", Retention())


def test_the_bus_reads_from_memory_and_disk_alike(tmp_path: Path) -> None:
    packets = packets_of(tmp_path)

    async def run() -> None:
        store = Store(tmp_path / "state", Retention())
        bus = Bus(1, store.recording("main"))  # memory keeps the newest group only
        remembered = Bus(10**8)
        for packet in packets:
            await bus.record(packet)
            bus.publish(packet)
            remembered.publish(packet)
        assert bus.recording is not None
        await bus.recording.flush()
        for first, last in ((0, 11), (2, 5), (9, 10), (4, 4)):
            span = Position(1, first), Position(1, last)
            assert [p.data for p in await bus.read(*span)] == [p.data for p in packets[first : last + 1]]
            assert [p.data for p in await remembered.read(*span)] == [p.data for p in packets[first : last + 1]]
        assert bus.oldest == remembered.oldest == Position(1, 0)
        assert bus.key_before(Position(1, 7)) == Position(1, 4)
        assert bus.key_after(Position(1, 4)) == Position(1, 8)
        store.close()

    asyncio.run(run())


def test_a_group_that_could_not_be_read_once_tells_its_times_later(tmp_path: Path) -> None:
    record(tmp_path / "state", packets_of(tmp_path))
    recording = reopened(tmp_path / "state")
    bus, file = Bus(1, recording), recording.segments[1].path

    def begins() -> list[int | None]:
        return [group.first_time_ns for group in asyncio.run(bus.groups())]

    hidden = file.rename(file.with_suffix(".hidden"))
    first, unread, last = begins()
    assert first is not None
    assert unread is None
    assert last is not None
    hidden.rename(file)
    assert begins()[1] is not None
