"""Pictures of files whose bytes were damaged: those that are shown are the ones that were filmed."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.data.video import probe_video, read_video
from tests.core.data.writers import copy_video, write_video

H264 = "threads=1:scenecut=0:keyint=12:min-keyint=12"
KINDS = {
    "h264": ("libx264", ".mp4", {"preset": "fast", "x264-params": f"{H264}:bframes=0"}),
    "h264 with B-pictures": ("libx264", ".mkv", {"preset": "fast", "x264-params": f"{H264}:bframes=2:b-adapt=0"}),
    "h264 in slices": ("libx264", ".mkv", {"preset": "fast", "x264-params": f"{H264}:bframes=0:slices=3"}),
    "h264 in avi": ("libx264", ".avi", {"preset": "fast", "x264-params": f"{H264}:bframes=2:b-adapt=0"}),
    "mpeg4": ("mpeg4", ".mp4", {"g": "12"}),
}
REFRESHED = {"preset": "fast", "x264-params": "threads=1:intra-refresh=1:keyint=12:bframes=0"}


def _scene(count: int) -> list[UInt8]:
    """[H,W,3] pictures of small squares that move, so that what is built upon damage shows it."""
    squares = np.random.default_rng(5).integers(0, 256, (16, 24, 3)).astype(np.uint8)
    whole = squares.repeat(8, 0).repeat(8, 1)
    return [np.roll(whole, 3 * number, 1) for number in range(count)]


def _shown(path: Path) -> dict[int, UInt8]:
    """Pictures by their number, at 30 a second."""
    return {
        round(time_ns * 30 / 1e9): np.asarray(frame.to_ndarray(format="rgb24")) for time_ns, frame in read_video(path)
    }


def _damage(path: Path, times: set[int], patch: bytes = bytes(range(1, 40))) -> None:
    """Overwrite bytes amid the samples of the pictures numbered `times`, in a file without times those samples."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size > 0]
    first = min(packet.pts for packet in packets if packet.pts is not None)
    data = bytearray(path.read_bytes())
    for number, packet in enumerate(packets):
        shown = number if packet.pts is None else round((packet.pts - first) * packet.time_base * 30)
        if shown in times:
            at = packet.pos + packet.size // 2
            end = min(at + len(patch), packet.pos + packet.size)
            data[at:end] = patch[: end - at]
    path.write_bytes(data)


def _differing(shown: dict[int, UInt8], clean: dict[int, UInt8]) -> list[int]:
    return [number for number, image in shown.items() if not np.array_equal(image, clean[number])]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_built_upon_damage_is_missing_up_to_the_next_keyframe(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    codec, suffix, options = KINDS[kind]
    path = tmp_path / f"cam{suffix}"
    write_video(path, _scene(36), codec=codec, options=options)
    clean = _shown(path)
    _damage(path, {13 if suffix == ".avi" else 15})  # 13 is shown as 15
    shown = _shown(path)
    assert _differing(shown, clean) == []
    lost = sorted(set(clean) - set(shown))
    assert lost == list(range(lost[0], 24))
    assert 13 <= lost[0] <= 15  # B-pictures before the damaged one are built upon it
    [told] = [record.getMessage() for record in caplog.records]
    assert f"cam{suffix}: is damaged at {lost[0] / 30:.3f} s" in told
    assert told.endswith(f"up to the next keyframe, {len(lost)} of its pictures are left out")


def test_a_damaged_keyframe_costs_its_group(tmp_path: Path) -> None:
    codec, suffix, options = KINDS["h264"]
    path = tmp_path / f"cam{suffix}"
    write_video(path, _scene(36), codec=codec, options=options)
    clean = _shown(path)
    _damage(path, {0, 24})
    shown = _shown(path)
    assert list(shown) == list(range(12, 24))
    assert _differing(shown, clean) == []


def test_damage_at_several_places_is_told_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    codec, suffix, options = KINDS["mpeg4"]
    path = tmp_path / f"cam{suffix}"
    write_video(path, _scene(36), codec=codec, options=options)
    _damage(path, {9, 21})
    assert sorted(set(range(36)) - set(_shown(path))) == [9, 10, 11, 21, 22, 23]
    [told] = [record.getMessage() for record in caplog.records]
    assert told.endswith("is damaged at 0.300 s, 0.700 s; up to the next keyframe, 6 of its pictures are left out")


@pytest.mark.parametrize("at", [15, 17, 23])
def test_an_intra_refresh_passes_as_a_whole_before_pictures_are_shown_again(tmp_path: Path, at: int) -> None:
    path = tmp_path / "cam.mp4"
    write_video(path, _scene(72), options=REFRESHED)
    clean = _shown(path)
    assert list(clean) == list(range(72))
    _damage(path, {at}, bytes(400))
    shown = _shown(path)
    assert _differing(shown, clean) == []
    lost = sorted(set(clean) - set(shown))
    assert lost[0] == at
    assert lost == list(range(at, lost[-1] + 1))
    assert 36 <= lost[-1] + 1 <= 48


def test_a_file_that_begins_with_an_intra_refresh_begins_where_that_is_whole(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_video(tmp_path / "whole.mp4", _scene(72), options=REFRESHED)
    clean = _shown(tmp_path / "whole.mp4")
    copy_video(tmp_path / "whole.mp4", tmp_path / "joined.mkv", skip=7)
    shown = _shown(tmp_path / "joined.mkv")
    assert list(shown) == list(range(min(shown), 72))
    assert 12 < min(shown) <= 24
    assert all(np.array_equal(image, clean[number]) for number, image in shown.items() if number >= 36)
    assert not caplog.records


@pytest.mark.parametrize("lost", [1, 3])
def test_packets_that_a_transport_stream_lost_are_damage(tmp_path: Path, lost: int) -> None:
    codec, _, options = KINDS["h264"]
    path = tmp_path / "cam.ts"
    write_video(path, _scene(36), codec=codec, options=options)
    clean = _shown(path)
    with av.open(str(path)) as container:
        at = [packet.pos for packet in container.demux(video=0) if packet.size > 0][15] + 188
    data = path.read_bytes()
    path.write_bytes(data[:at] + data[at + 188 * lost :])
    shown = _shown(path)
    assert _differing(shown, clean) == []
    assert {*range(14), *range(24, 36)} <= set(shown)


def test_a_sample_of_an_avi_that_cannot_be_found_shifts_no_other(tmp_path: Path) -> None:
    """Its four letters are damaged, so that FFmpeg looks for the next sample and does not count this one."""
    codec, suffix, options = KINDS["h264 in avi"]
    path = tmp_path / f"cam{suffix}"
    write_video(path, _scene(36), codec=codec, options=options)
    clean = _shown(path)
    with av.open(str(path)) as container:
        at = [packet.pos for packet in container.demux(video=0) if packet.size > 0][15] - 8
    data = path.read_bytes()
    assert data[at : at + 4] == b"00dc"
    path.write_bytes(data[:at] + b"\xff\xfe\xfd\xfc" + data[at + 4 :])
    shown = _shown(path)
    assert {*range(24, 36)} <= set(shown)
    assert all(np.array_equal(shown[number], clean[number]) for number in range(24, 36))
    assert [round(time_ns * 30 / 1e9) for time_ns in probe_video(path).times_ns] == [t for t in range(36) if t != 15]
