"""A rendered board walk calibrated by command: poses, offsets and focal lengths beside the truth.

    python -m tests.bench.walk_bench [--cameras 8 --seconds 60 --fps 10 --size 640x480 --square-mm 100
        --exposure-ms 0 --readout-ms 0 --out DIR]

Distorted cameras on an arc three metres away, noise, and clocks up to half a frame apart film a board that somebody
carries about. Wanted: 0.1 degrees, 2 mm, 0.1 frame. Pictures may be blurred by an exposure, and be read line by line
(every second camera takes 0.6 of that time). With --out the videos stay there.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.board.description import FILE, Board, board_text
from streamlod.core.data import open_dataset
from streamlod.server.cli.calibrate import calibrate
from tests.core.calibration import walks
from tests.core.calibration.alignment import differences
from tests.core.calibration.filmed import filmed, rays_of
from tests.core.data.writers import write_video

MOMENTS = 5  # of an exposure


@dataclass(frozen=True, slots=True)
class Shutter:
    """How long pictures are exposed, and how long after its first line the last one is, in seconds."""

    exposure: float
    readout: float

    def moments(self, height: int) -> Float64:
        """[S,2H] seconds from a picture's time at which its rows are lit, twice as many as it has."""
        lit = self.exposure * ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5) if self.exposure else np.zeros(1)
        rows = (np.arange(2 * height) + 0.5) / (2 * height) - 0.5
        return np.asarray(lit[:, None] + self.readout * rows, np.float64)


def film(rig: walks.Rig, number: int, clock: Float64, board: Board, shutter: Shutter) -> Iterator[UInt8]:
    """The pictures of one camera at the times of its `clock`, as the walk counts them."""
    rays, moments = rays_of(rig.lenses[number], rig.size), shutter.moments(rig.size[1])
    if not moments.any():
        moments = np.zeros((1, 1))
    for seed, time_s in enumerate(clock):
        times = (time_s + moments).ravel()
        boards = rigid.after(rig.poses[number], walks.board_at(times))
        away = np.einsum("ni,ni->n", rigid.rotations(boards[:, :3])[:, :, 2], boards[:, 3:]) < 0
        boards[away] = [0, 0, 0, 0, 0, -10.0]  # its back is blank
        yield filmed(rays, boards.reshape(*moments.shape, 6), rig.size, board, seed + 100_000 * number)


def walk(
    folder: Path, rig: walks.Rig, offsets: Float64, seconds: float, fps: int, board: Board, shutter: Shutter
) -> None:
    """A folder of videos and the board's description; a camera's clock shows the common time less its offset."""
    (folder / FILE).write_text(board_text(board))
    clock = np.arange(round(seconds * fps)) / fps
    for number, name in enumerate(rig.names):
        own = replace(shutter, readout=shutter.readout * (0.6 if number % 2 else 1.0))
        pictures = list(film(rig, number, clock + offsets[number], board, own))
        write_video(folder / f"{name}.mp4", pictures, fps, options={"crf": "12"})


def compared(folder: Path, rig: walks.Rig, offsets: Float64, fps: int) -> str:
    """A table of what the calibration in `folder` is off, camera by camera."""
    recording = open_dataset(folder).recording
    cameras = {camera.name: camera for camera in recording.cameras}
    found = [cameras[name] for name in rig.names]
    degrees, metres = differences(np.array([rigid.pose(each.world_to_camera) for each in found]), rig.poses)
    focal = [each.intrinsics[0, 0] / lens[0] - 1 for each, lens in zip(found, rig.lenses, strict=True)]
    told = json.loads((folder / "transforms.json").read_text())["frames"]
    told = {Path(each["file_path"]).stem: each.get("time_offset", 0.0) for each in told}
    late = np.array([told[name] for name in rig.names])
    frames = ((late - late[0]) - (offsets - offsets[0])) * fps
    lines = [
        "| camera | degrees | mm | offset, frames | of it wrong | focal length, % |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row, name in enumerate(rig.names):
        figures = degrees[row], 1000 * metres[row], offsets[row] * fps, frames[row], 100 * focal[row]
        lines.append(f"| {name} | " + " | ".join(f"{each:.3f}" for each in figures) + " |")
    worst = degrees.max(), 1000 * metres.max(), np.abs(frames).max()
    lines.append("at most {:.3f} degrees, {:.2f} mm, {:.3f} frames".format(*worst))
    return "\n".join(lines)


def main() -> None:
    """Film, calibrate and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--fps", type=int, default=10)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--square-mm", type=float, default=100.0)
    parser.add_argument("--exposure-ms", type=float, default=0.0)
    parser.add_argument("--readout-ms", type=float, default=0.0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    rig, board = walks.rig(given.cameras, (width, height)), Board(square_m=given.square_mm / 1000)
    shutter = Shutter(given.exposure_ms / 1000, given.readout_ms / 1000)
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, given.cameras) / given.fps
    with ExitStack() as stack:
        folder = given.out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        begin = time.perf_counter()
        walk(folder, rig, offsets, given.seconds, given.fps, board, shutter)
        filmed_at = time.perf_counter()
        print(calibrate(folder, None, None, None, None, overwrite=True))
        print(f"filmed in {filmed_at - begin:.0f} s, calibrated in {time.perf_counter() - filmed_at:.0f} s")
        print(compared(folder, rig, offsets, given.fps))


if __name__ == "__main__":
    main()
