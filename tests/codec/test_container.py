"""`.slod` files: order, index, torn ends, live appending, seeking."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.codec.container import SlodReader, SlodWriter
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.opening import open_packets
from streamlod.codec.packet.levels import split_levels
from streamlod.core.errors import BitstreamError, InputError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from tests.codec.scenes import assert_same_state, make_scene, steps
from tests.small_disk import files_up_to
from tests.work import lines, memory

FRAMES = 6


@pytest.fixture(scope="module")
def clip() -> tuple[list[Scene], list[bytes]]:
    """States 0 to FRAMES and the packets that lead there, the keyframe first."""
    states, residuals = steps(make_scene((5, 30)), FRAMES)
    packets = [encode_keyframe(states[0], time_ns=0, profile=0)]
    for number, (state, residual) in enumerate(zip(states, residuals, strict=False)):
        time_ns = (number + 1) * 1000
        packets.append(encode_residual(state, residual, time_ns=time_ns, profile=0))
    return states, packets


def _write(path: Path, packets: list[bytes]) -> None:
    with SlodWriter(path) as writer:
        for number, packet in enumerate(packets):
            assert writer.append(packet) == number


def test_what_is_written_is_read(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    _, packets = clip
    path = tmp_path / "a.slod"
    _write(path, packets)
    assert list(tmp_path.iterdir()) == [path]
    with SlodReader(path) as reader:
        assert list(reader.packets()) == packets
        assert not reader.torn
        assert [e.to_version for e in reader.entries] == list(range(FRAMES + 1))


def test_an_exception_leaves_nothing_behind(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    with pytest.raises(RuntimeError), SlodWriter(tmp_path / "a.slod") as writer:  # noqa: PT012
        writer.append(clip[1][0])
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_what_was_written_whole(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    path, (_, packets) = tmp_path / "a.slod", clip
    with SlodWriter(path) as writer:
        writer.append(packets[0])
        (written,) = (each.stat().st_size for each in tmp_path.iterdir())
        with files_up_to(written + len(packets[1]) // 2), pytest.raises(OSError, match=r"a\.slod"):
            writer.append(packets[1])
    with SlodReader(path) as reader:
        assert ([*reader.packets()], reader.is_whole) == ([packets[0]], True)


def test_a_disk_without_room_for_the_index_leaves_a_file_without(
    tmp_path: Path, clip: tuple[list[Scene], list[bytes]]
) -> None:
    path, (_, packets) = tmp_path / "a.slod", clip
    writer = SlodWriter(path)
    writer.append(packets[0])
    (written,) = (each.stat().st_size for each in tmp_path.iterdir())
    with files_up_to(written + 4):
        writer.close()
    with SlodReader(path) as reader:
        assert ([*reader.packets()], reader.records_end) == ([packets[0]], written)
    assert [*tmp_path.iterdir()] == [path]


def test_a_full_disk_is_told_before_anything_is_written(tmp_path: Path) -> None:
    with files_up_to(2), pytest.raises(OSError, match=r"a\.slod"):
        SlodWriter(tmp_path / "a.slod")
    assert [*tmp_path.iterdir()] == []


def test_every_torn_end_gives_the_packets_before_it(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    _, packets = clip
    path = tmp_path / "a.slod"
    _write(path, packets)
    whole = path.read_bytes()
    ends = [8]
    for packet in packets:
        ends.append(ends[-1] + 4 + len(packet))
    for length in [*range(len(whole) - 1, ends[-2], -7), *range(8, ends[1], 211)]:
        path.write_bytes(whole[:length])
        with SlodReader(path) as reader:
            complete = sum(end <= length for end in ends[1:])
            assert list(reader.packets()) == packets[:complete]
            assert reader.torn == (length not in ends)


def test_a_live_file_is_readable_and_goes_on_after_a_crash(
    tmp_path: Path, clip: tuple[list[Scene], list[bytes]]
) -> None:
    _, packets = clip
    path = tmp_path / "live.slod"
    writer = SlodWriter(path, live=True)
    for packet in packets[:3]:
        writer.append(packet)
    with SlodReader(path) as reader:
        assert list(reader.packets()) == packets[:3]
    crashed = path.read_bytes() + b"\x40\x00\x00\x00half a packet"
    writer.close()
    path.write_bytes(crashed)
    for more in (packets[3:5], packets[5:]):  # the second time after an orderly close
        with SlodWriter(path, live=True) as writer:
            for packet in more:
                writer.append(packet)
    with SlodReader(path) as reader:
        assert list(reader.packets()) == packets


def test_seeking_takes_the_cheapest_way(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    states, packets = clip
    total = difference(states[0], states[5])
    catch_up = encode_residual(states[0], total, time_ns=5000, profile=0)
    path = tmp_path / "a.slod"
    _write(path, [*split_levels(packets[0]), *packets[1:], catch_up])
    with SlodReader(path) as reader:
        assert reader.plan(2) == (0, 1, 2, 3)
        assert reader.plan(6) == (0, 1, len(packets) + 1, 7)
        for version in range(FRAMES + 1):
            decoder = SceneDecoder()
            for number in reader.plan(version):
                decoder.push(reader.read(number))
            assert_same_state(states[version], decoder.scene)
        with pytest.raises(InputError):
            reader.plan(99)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.slod"
    for content in (b"", b"SLO", b"PK\x03\x04 a zip archive", b"SLOD\x02", b"SLOD\1\0\0\1"):
        path.write_bytes(content)
        with pytest.raises(BitstreamError) as refused:
            SlodReader(path)
        assert refused.value.code == "bad_file"
    with pytest.raises(InputError):
        SlodReader(tmp_path / "absent.slod")


def test_a_wrong_index_is_not_believed(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    _, packets = clip
    path = tmp_path / "a.slod"
    _write(path, packets)
    whole = bytearray(path.read_bytes())
    whole[-30] ^= 1  # inside the last entry of the index
    path.write_bytes(whole)
    with SlodReader(path) as reader:
        assert list(reader.packets()) == packets


@pytest.mark.long
def test_the_way_through_a_long_chain_takes_linear_time(tmp_path: Path, clip: tuple[list[Scene], list[bytes]]) -> None:
    """Also with steps that lead nowhere or back, as a hostile index may hold: four times the steps, as much work."""
    path = tmp_path / "a.slod"
    _write(path, clip[1])
    work, space = [], []
    with SlodReader(path) as reader:
        key, step, *_ = reader.entries
        for length in (5_000, 20_000):  # long ones, beside which what other threads take is little
            chain = [replace(step, from_version=n, to_version=n + 1) for n in range(length)]
            loops = [replace(step, from_version=n, to_version=max(n - 1, 0), size_bytes=0) for n in range(0, length, 7)]
            nowhere = [replace(e, to_version=e.from_version, size_bytes=0) for e in chain[:9]]
            reader.entries = (key, *chain, *loops, *nowhere)
            with memory() as taken, lines(100 * length) as counted:
                assert reader.plan(length) == tuple(range(length + 1))
            work.append(counted.count)
            space.append(taken.peak_bytes)
    assert work[1] < 4.1 * work[0]
    assert space[1] < 5 * space[0]  # and not sixteen times


@pytest.mark.timeout(20)
def test_a_pipe_is_refused_instead_of_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.slod")
    with pytest.raises(InputError, match=r"a\.slod: is a pipe"):
        open_packets(tmp_path / "a.slod")
