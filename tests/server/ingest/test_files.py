"""Rigs whose cameras are files: upright, paired by their times, and refused where they can give nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.data.video.file import ONE_CLOCK
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.definition import read_uncalibrated
from streamlod.server.ingest.live import open_live
from tests.core.data.writers import copy_video, put_display_matrix, rig, write_transforms, write_video
from tests.server.ingest.rig import FPS, burnt, number_of, write_definition

PICTURES = [burnt(number) for number in range(12)]
GROUPS = {"g": "4", "x264-params": "scenecut=0"}


def _write(path: Path, pictures: Sequence[UInt8] = PICTURES, **options: object) -> None:
    write_video(path, pictures, **options)  # type: ignore[arg-type]


def _seen(folder: Path, sources: Sequence[str], policy: object = "require_all") -> list[list[int | None]]:
    """For each instant, the number in each camera's picture."""
    rig = write_definition(folder, list(sources), policy, realtime=False)
    return [
        [number_of(image) if present else None for image, present in zip(frame.images, frame.present, strict=True)]
        for frame in open_live(rig).frames()
    ]


@pytest.mark.parametrize(("matrix", "quarters"), [((-1, 0, 0, -1), 2), ((0, 1, -1, 0), 1), ((0, -1, 1, 0), -1)])
def test_turned_files_are_trained_upright(tmp_path: Path, matrix: tuple[float, ...], quarters: int) -> None:
    _write(tmp_path / "a.mp4")
    _write(tmp_path / "b.mp4", [np.rot90(image, quarters) for image in PICTURES])
    put_display_matrix(tmp_path / "b.mp4", *matrix)
    assert _seen(tmp_path, ["a.mp4", "b.mp4"]) == [[t, t] for t in range(12)]


def test_files_without_times_have_the_rigs_rate(tmp_path: Path) -> None:
    _write(tmp_path / "a.mp4")
    _write(tmp_path / "b.h264", options={"bf": "2"})
    _write(tmp_path / "c.hevc", codec="libx265", options={"x265-params": "log-level=none"})
    assert _seen(tmp_path, ["a.mp4", "b.h264", "c.hevc"]) == [[t] * 3 for t in range(12)]


def test_files_of_all_kinds_are_paired_by_their_times(tmp_path: Path) -> None:
    """One lost a picture, one joined in mid-group, one is hidden in part by an edit list, one has B-frames."""
    kept = [t for t in range(12) if t != 6]
    lossy = [t * 1000 // 30 for t in kept]
    _write(tmp_path / "lost.mkv", [PICTURES[t] for t in kept], times=lossy, time_base=Fraction(1, 1000))
    _write(tmp_path / "whole.mp4", options=GROUPS)
    copy_video(tmp_path / "whole.mp4", tmp_path / "joined.mp4", skip=1)
    _write(tmp_path / "longer.mp4", [PICTURES[0]] * 2 + PICTURES, options={"g": "20"})
    copy_video(tmp_path / "longer.mp4", tmp_path / "cut.mp4", earlier=2)
    _write(tmp_path / "b.mp4", options={"bf": "2"}, muxing={"movflags": "frag_keyframe+empty_moov"})
    seen = _seen(tmp_path, ["lost.mkv", "joined.mp4", "cut.mp4", "b.mp4"], {"quorum": 3})
    assert [row for row in seen if row[2] is not None and row[2] >= 4] == [
        [None if t == 6 else t, t, t, t] for t in range(4, 12)
    ]


@pytest.mark.parametrize(("comment", "late"), [(ONE_CLOCK, 2), ("", 0)])
def test_offsets_of_a_walk_on_one_clock_hold_live_too(tmp_path: Path, comment: str, late: int) -> None:
    """Those of files that were started apart do not."""
    walk = tmp_path / "walk"
    walk.mkdir()
    for name in "ab":
        _write(walk / f"{name}.mp4", comment=comment)
    cameras = rig(["a", "b"], (PICTURES[0].shape[1], PICTURES[0].shape[0]))
    write_transforms(walk, ["a.mp4", "b.mp4"], cameras)
    found = json.loads((walk / "transforms.json").read_text())
    found["frames"][1]["time_offset"] = 2 / FPS
    (walk / "transforms.json").write_text(json.dumps(found))
    entries = [{"name": name, "source": f"walk/{name}.mp4"} for name in "ab"]
    live = tmp_path / "rig.json"
    live.write_text(json.dumps({"fps": FPS, "calibration": "walk", "realtime": False, "cameras": entries}))
    seen = [[number_of(image) for image in frame.images] for frame in open_live(live).frames() if frame.present.all()]
    assert seen == [[t, t - late] for t in range(late, 12)]


def test_an_offset_that_the_file_states_is_added(tmp_path: Path) -> None:
    for name in "ab":
        _write(tmp_path / f"{name}.mp4")
    live = write_definition(tmp_path, ["a.mp4", "b.mp4"], realtime=False)
    stated = json.loads(live.read_text())
    stated["cameras"][1]["offset_ms"] = 2000 / FPS
    live.write_text(json.dumps(stated))
    seen = [[number_of(image) for image in frame.images] for frame in open_live(live).frames() if frame.present.all()]
    assert seen == [[t, t - 2] for t in range(2, 12)]
    assert read_uncalibrated(live).offsets_ns == {"cam1": round(2e9 / FPS)}  # a walk is recorded with it
    stated["cameras"][1]["offset_ms"] = 1e6
    live.write_text(json.dumps(stated))
    with pytest.raises(InputError, match=r"cameras\.1\.offset_ms"):
        open_live(live)


def test_files_that_begin_or_pause_long_after_the_others(tmp_path: Path) -> None:
    """Readers wait for each other by time, not by counting; nothing is a stray because its file is read faster."""
    many = [burnt(t) for t in range(90)]
    _write(tmp_path / "a.mp4", many)
    _write(tmp_path / "late.mp4", many[60:], times=list(range(60, 90)))
    paused = [*range(5), *range(70, 90)]
    _write(tmp_path / "paused.mp4", [many[t] for t in paused], times=paused)
    assert _seen(tmp_path, ["a.mp4", "late.mp4"]) == [[t, t] for t in range(60, 90)]
    seen = _seen(tmp_path, ["paused.mp4", "a.mp4"], {"quorum": 1})
    assert seen == [[t if t in paused else None, t] for t in range(90)]


@pytest.mark.parametrize("realtime", [True, False])
def test_files_that_can_give_nothing_are_refused(tmp_path: Path, realtime: bool) -> None:
    _write(tmp_path / "a.mp4", PICTURES * 50)
    (tmp_path / "bad.mp4").write_bytes(b"no video" * 100)
    with pytest.raises(InputError, match=r"camera cam1: there is no file .*nothing\.mp4"):
        open_live(write_definition(tmp_path, ["a.mp4", "nothing.mp4"], realtime=realtime))
    with pytest.raises(InputError, match=r"camera cam1: there is no file"):
        open_live(write_definition(tmp_path, ["a.mp4", "."], realtime=realtime))
    damaged = open_live(write_definition(tmp_path, ["a.mp4", "bad.mp4"], realtime=realtime))
    with pytest.raises(InputError, match=r"camera cam1: .*no instant has as many cameras as it needs"):
        next(damaged.frames())


def test_a_file_that_turns_bad_ends_there(tmp_path: Path) -> None:
    _write(tmp_path / "a.mp4")
    _write(tmp_path / "whole.mp4", options=GROUPS)
    copy_video(tmp_path / "whole.mp4", tmp_path / "bad.mkv", damaged=9)
    (tmp_path / "torn.mkv").write_bytes((tmp_path / "bad.mkv").read_bytes()[:-700])
    seen = _seen(tmp_path, ["a.mp4", "torn.mkv"])
    assert seen == [[t, t] for t in range(len(seen))]
    assert 4 <= len(seen) <= 9
    assert _seen(tmp_path, ["a.mp4", "torn.mkv"], {"quorum": 1}) == [
        [t, t if t < len(seen) else None] for t in range(12)
    ]
