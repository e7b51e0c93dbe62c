"""The pictures of docs/filming.md: where cameras may stand, and what faults look like.

    python -m tests.bench.filming_pictures [--out docs/images]

Writes `filming-rigs.webp`, rigs from above, coloured by how many of their cameras see a place, and
`filming-faults.jpg`, a picture as it should be, and such as lead to the sentences of the guide's table. All of them are
rendered here.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.checks.coverage import is_seen_by
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.synthetic import SyntheticSpec, render_image
from streamlod.server.ingest.finding.sheet import contact_sheet
from tests.core.calibration.filmed import filmed, rays_of

SIZE = 480, 360
SPEC = SyntheticSpec(cameras=5, frames=24, width=SIZE[0], height=SIZE[1], kind="hard")
LENS = np.array([0.85 * SIZE[0], 0.85 * SIZE[0], *(np.array(SIZE) - 1) / 2, 0, 0, 0, 0, 0])
FACING = np.array([0.25, -0.3, 0.05, -0.19, -0.13, 0.75])  # of a board held well
RIGS = {
    "4 cameras, 60 degrees": (4, 60.0),
    "4 all round a room": (4, 270.0),
    "6 cameras, 100 degrees": (6, 100.0),
    "12 cameras, a half circle": (12, 180.0),
}
REACH = 3.6  # metres drawn to each side
STEPS = 240


def rig(count: int, degrees: float) -> list[Camera]:
    """Cameras three metres from the middle, on an arc, with the lens of a phone that lies on its side."""
    found = []
    for number, angle in enumerate(np.radians(np.linspace(-degrees / 2, degrees / 2, count) - 90)):
        eye = np.array([3 * np.cos(angle), 3 * np.sin(angle), 0.0])
        pose = look_at(eye, np.zeros(3), np.array([0.0, 0, 1]))
        found.append(pinhole(f"cam{number}", (1000.0, 1000.0), (640, 360), (1280, 720), pose))
    return found


def rigs() -> bytes:
    """A WebP of the rigs from above."""
    line = np.linspace(-REACH, REACH, STEPS)
    places = np.stack([*np.meshgrid(line, line), np.zeros((STEPS, STEPS))], axis=-1).reshape(-1, 3)
    figure = Figure(figsize=(9.6, 2.9), layout="constrained", dpi=100)
    colours = ListedColormap(["#ffffff", "#e3e3e3", "#bcd4ea", "#6fa8d6", "#1f6fb4"])
    for axes, (name, (count, degrees)) in zip(figure.subplots(1, len(RIGS)), RIGS.items(), strict=True):
        cameras = rig(count, degrees)
        seen = np.sum([is_seen_by(camera, places) for camera in cameras], axis=0).reshape(STEPS, STEPS)
        shown = axes.imshow(
            np.minimum(seen, 4), origin="lower", extent=(-REACH, REACH) * 2, cmap=colours, vmin=-0.5, vmax=4.5
        )
        for camera in cameras:
            x, y = camera.centre[:2]
            axes.arrow(x, y, -0.12 * x, -0.12 * y, width=0.03, head_width=0.2, color="#d9480f")
        axes.set_title(name, fontsize=8)
        axes.set_xticks([])
        axes.set_yticks([])
    bar = figure.colorbar(shown, ax=figure.axes, ticks=range(5), shrink=0.8)
    bar.ax.set_yticklabels(["none", "1", "2", "3", "4 or more"], fontsize=7)
    bar.set_label("cameras that see it", fontsize=7)
    file = BytesIO()
    figure.savefig(file, format="webp")
    return file.getvalue()


def board_shown(*poses: np.ndarray, moved: float = 0.0) -> UInt8:
    """One board or more in a grey room, moved by so many metres to the side while the picture is exposed."""
    rays, board = rays_of(LENS, SIZE), Board()
    aside = np.array([0, 0, 0, 1.0, 0, 0])
    found = []
    for pose in poses:
        moments = [filmed(rays, pose + moved * part * aside, SIZE, board) for part in np.linspace(-0.5, 0.5, 9)]
        found.append(np.mean(moments if moved else moments[:1], axis=0))
    room = 110.0
    strongest = [np.abs(picture - room) for picture in found]
    both = found[0] if len(found) == 1 else np.where(strongest[0] > strongest[1], found[0], found[1])
    return np.asarray(both, np.uint8)


def faults() -> Iterator[tuple[str, UInt8]]:
    """Each fault's words and its picture."""
    room, later = (render_image(SPEC, index, 2) for index in (0, 12))
    aside = np.array([0.0, 0, 0, 0.22, 0, 0.3])
    yield "as it should be", room
    yield "out of focus or dirty", cv2.GaussianBlur(room, (0, 0), 3.5).astype(np.uint8)
    yield "dark", np.asarray(room * 0.12, np.uint8)
    yield "ghosts: not at one time", np.asarray((room.astype(np.float64) + later) / 2, np.uint8)
    yield "knocked: by 2 degrees", knocked(room)
    yield "colours change: not locked", np.asarray(np.clip(room * np.array([1.25, 1.0, 0.7]), 0, 255), np.uint8)
    yield "a board held well", board_shown(FACING)
    yield "board: too far", board_shown(FACING + np.array([0, 0, 0, 0, 0, 3.2]))
    yield "board: moved too fast", board_shown(FACING, moved=0.12)
    yield "board: mirrored", np.ascontiguousarray(board_shown(FACING)[:, ::-1])
    yield "two boards at once", board_shown(FACING - aside * [1, 1, 1, 1, 1, -1], FACING + aside)
    yield "board: half outside", board_shown(FACING + np.array([0, 0, 0, 0.42, 0.22, 0]))


def knocked(picture: UInt8) -> UInt8:
    """The picture beside what the camera saw before, as far apart as a turn by two degrees puts them."""
    shift = np.array([[1.0, 0, 0.85 * SIZE[0] * np.radians(2)], [0, 1, 4]])
    moved = cv2.warpAffine(picture, shift, SIZE, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray((picture.astype(np.float64) + moved) / 2, np.uint8)


def sheet(pictures: Sequence[tuple[str, UInt8]]) -> bytes:
    """A JPEG of all, half as large as the sheet of cameras."""
    whole = cv2.imdecode(np.frombuffer(contact_sheet(dict(pictures), {}), np.uint8), cv2.IMREAD_COLOR)
    small = cv2.resize(whole, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    ok, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])
    assert ok
    return data.tobytes()


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    out = parser.parse_args().out
    (out / "filming-rigs.webp").write_bytes(rigs())
    (out / "filming-faults.jpg").write_bytes(sheet(list(faults())))


if __name__ == "__main__":
    main()
