"""Calibrations of parts of a recording, beside that of its whole; or those without a board, beside a known one.

    python -m tests.bench.recalibration_bench DATA [--features [--lenses FOLDER]]

Without options the board in DATA is found once, and its cameras are calibrated by all pictures, each half of them,
every second and every third, and without each camera in turn; the first is compared with DATA's own calibration, where
there is one. With --features, `calibrate --features` is run on DATA,
and compared with DATA's own calibration, whose units are kept: the truth of a clip of `streamlod synth`, or the file of
caliscope. Degrees and mm of each camera, after rotations and centres are aligned, beside what is stated for the part.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.observations import Observations
from streamlod.core.calibration.board.seen import board_as_seen, track_of
from streamlod.core.calibration.files import RIG
from streamlod.core.calibration.solve import Calibration, calibrate
from streamlod.core.calibration.track import Track
from streamlod.core.calibration.walk import open_walk
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from streamlod.core.data.lens import opencv_matrix
from streamlod.core.errors import InputError
from streamlod.server.cli.calibrate import board_of
from streamlod.server.cli.calibrate_features import calibrate_features
from tests.core.calibration.alignment import differences


def poses_of(cameras: Sequence[Camera]) -> Float64:
    """[C,6] world to camera."""
    return np.array([rigid.pose(camera.world_to_camera) for camera in cameras])


def some(tracks: Sequence[Track], rows: slice) -> list[Track]:
    """The same with some pictures of each camera."""
    return [replace(track, times=track.times[rows], corners=track.corners[rows]) for track in tracks]


def parts_of(tracks: Sequence[Track]) -> Iterator[tuple[str, list[Track]]]:
    """Parts of a recording, by name."""
    half = max(len(track.times) for track in tracks) // 2
    yield "first half", some(tracks, slice(0, half))
    yield "second half", some(tracks, slice(half, None))
    for step in (2, 3):
        for first in range(step):
            yield f"every {step}. from {first}", some(tracks, slice(first, None, step))
    for left_out in tracks if len(tracks) > 2 else ():
        yield f"without {left_out.camera}", [track for track in tracks if track is not left_out]


def row_of(name: str, part: Calibration, whole: Calibration) -> tuple[str, Float64]:
    """A row of the table, and [2] the largest errors in parts of those stated."""
    cameras = {camera.name: camera for camera in whole.cameras}
    there = poses_of([cameras[camera.name] for camera in part.cameras])
    off = np.stack(differences(poses_of(part.cameras), there), axis=1) * [1, 1000]
    stated = part.errors * [1, 1000]
    cells = [" ".join(f"{each:.{places}f}" for each in values)
             for column, places in ((0, 2), (1, 1)) for values in (off[:, column], stated[:, column])]  # fmt: skip
    return f"| {name} | {' | '.join(cells)} |", np.asarray((off / stated).max(axis=0), np.float64)


def by_parts(data: Path) -> None:
    """Print how well the calibrations of parts agree with that of the whole."""
    footage = open_walk(data)
    board = board_as_seen(footage, board_of(None, None, data))
    tracks = [track_of(each, board) for each in footage]
    whole = calibrate(tracks, board)
    print(f"cameras {', '.join(camera.name for camera in whole.cameras)}")
    print("| part | degrees | stated | mm | stated |\n| --- | --- | --- | --- | --- |")
    print(row_of("whole", whole, whole)[0])
    ratios = []
    for name, part in parts_of(tracks):
        try:
            row, ratio = row_of(name, calibrate(part, board), whole)
        except InputError as error:
            row = f"| {name} | refused: {error} | | | |"
        else:
            ratios.append(ratio)
        print(row, flush=True)
    most = np.max(ratios, axis=0)
    print(f"at most {most[0]:.1f} times the degrees and {most[1]:.1f} times the mm that are stated")
    try:
        own = open_dataset(data).recording.cameras
    except InputError as error:
        print(f"no calibration to compare with: {error}")
    else:
        found = {camera.name: camera for camera in whole.cameras}
        placed = [found[camera.name] for camera in own]
        print_beside(own, poses_of(placed), [camera.intrinsics[0, 0] for camera in placed])
        theirs = {camera.name: camera for camera in own}
        for which, cameras in ("found", whole.cameras), ("own", [theirs[camera.name] for camera in whole.cameras]):
            missed = ", ".join(f"{each:.2f}" for each in triangulated(whole.seen, cameras))
            print(f"corners of one time, each placed by the cameras that are {which}: missed by {missed} px")


def triangulated(seen: Observations, cameras: Sequence[Camera]) -> Float64:
    """[C] root mean square of pixels by which cameras miss corners, each placed in space by all that saw it.

    Nothing is left out, and no corner is told where the board's others are, so that this is more than `rms px`.
    """
    lenses = [(opencv_matrix(camera), np.asarray(camera.distortion)) for camera in cameras]
    rays = np.zeros_like(seen.value)
    for number, lens in enumerate(lenses):
        mine = seen.camera == number
        rays[mine] = cv2.undistortPoints(seen.value[mine][:, None], *lens)[:, 0]
    same = defaultdict[tuple[float, ...], list[int]](list)
    for row, (instant, point) in enumerate(zip(seen.instant, np.round(seen.point, 6), strict=True)):
        same[instant, *point].append(row)
    missed = defaultdict[int, list[float]](list)
    for rows in (rows for rows in same.values() if len(rows) > 1):
        to_camera = [cameras[seen.camera[row]].world_to_camera[:3] for row in rows]
        planes = [rays[row, axis] * pose[2] - pose[axis] for row, pose in zip(rows, to_camera, strict=True)
                  for axis in (0, 1)]  # fmt: skip
        place = np.linalg.svd(np.array(planes))[2][-1]
        for row, pose in zip(rows, to_camera, strict=True):
            number = int(seen.camera[row])
            shown, _ = cv2.projectPoints(pose @ place / place[3], np.zeros(3), np.zeros(3), *lenses[number])
            missed[number].append(float(((shown.ravel() - seen.value[row]) ** 2).sum()))
    return np.array([np.sqrt(np.mean(missed[number])) for number in range(len(cameras))])


def by_features(data: Path, lenses: Path | None) -> None:
    """Print how far a calibration without a board is from DATA's own."""
    truth = open_dataset(data).recording.cameras
    metres = float(np.linalg.norm(truth[0].centre - truth[1].centre))
    with tempfile.TemporaryDirectory() as folder:
        begin, used = time.perf_counter(), time.process_time()
        apart = f"{truth[0].name}:{truth[1].name}={metres:.6f}"
        print(calibrate_features(data, Path(folder), apart, lenses, overwrite=True))
        print(f"in {time.perf_counter() - begin:.0f} s, {time.process_time() - used:.0f} CPU s")
        found = {each["name"]: each for each in json.loads((Path(folder) / RIG).read_text())["cameras"]}
    placed = [found[camera.name] for camera in truth]
    poses = np.array([rigid.pose(np.array(each["world_to_camera"])) for each in placed])
    print_beside(truth, _of_one_size(poses, poses_of(truth)), [each["intrinsics"][0][0] for each in placed])


def print_beside(truth: Sequence[Camera], poses: Float64, focals: Sequence[float]) -> None:
    """Print how far cameras with `poses` [C,6] and focal lengths in pixels are from `truth`."""
    degrees, off = differences(poses, poses_of(truth))
    print("| camera | degrees | mm | focal length, % |\n| --- | --- | --- | --- |")
    for true, focal, *errors in zip(truth, focals, degrees, 1000 * off, strict=True):
        print(f"| {true.name} | {errors[0]:.3f} | {errors[1]:.2f} | {100 * (focal / true.intrinsics[0, 0] - 1):.2f} |")
    print(f"at most {degrees.max():.3f} degrees, {1000 * off.max():.2f} mm")


def _of_one_size(found: Float64, truth: Float64) -> Float64:
    """Cameras `found` [C,6], whose centres are as far from their middle as those of `truth` [C,6]."""
    here, there = (rigid.inverse(each)[:, 3:] for each in (found, truth))
    factor = np.linalg.norm(there - there.mean(axis=0)) / np.linalg.norm(here - here.mean(axis=0))
    return np.concatenate([found[:, :3], found[:, 3:] * factor], axis=1)


def main() -> None:
    """Calibrate and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--features", action="store_true")
    parser.add_argument("--lenses", type=Path, help="folder of a calibration whose lenses are kept, with --features")
    given = parser.parse_args()
    try:
        if given.features:
            by_features(given.data, given.lenses)
        else:
            by_parts(given.data)
    except InputError as error:
        parser.exit(1, f"refused: {error}\n")


if __name__ == "__main__":
    main()
