"""The report of a calibration: a table, sentences of advice, and a picture."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.instants import ACROSS, DOWN, cell_numbers
from streamlod.core.calibration.solve import Calibration
from streamlod.core.calibration.walk_coverage import QUARTERS
from streamlod.core.data.names import spoken
from streamlod.core.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WEAK_PIXELS = 1.0  # root mean square from which pictures or lens should be looked at
_WEAK_DEGREES = 0.3  # standard error of a direction, mostly that of the lens's centre
_WEAK_SECONDS = 0.005  # standard deviation of a camera's times
_SLOW_READOUT = 0.01  # seconds from which what people do is seen to be slanted
_WEAK_SEEN = 0.35  # part of a picture's cells that the board should have been in


def table_of(calibration: Calibration) -> str:
    """A row for each camera, and one for all."""
    head = f"{'camera':<16}{'instants':>9}{'corners':>9}{'rms px':>8}{'median':>8}{'seen':>6}{'+-deg':>8}{'+-mm':>7}"
    lines = [f"{head}{'offset ms':>11}{'frames':>8}"]
    for number, camera in enumerate(calibration.cameras):
        mine = calibration.seen.camera == number
        instants = len(np.unique(calibration.seen.instant[mine]))
        degrees, metres = calibration.errors[number]
        offset = calibration.offsets[number]
        lines.append(
            f"{camera.name[-15:]:<16}{instants:>9}{mine.sum():>9}{calibration.rms(number):>8.3f}"
            f"{calibration.median(number):>8.3f}{100 * _cells(calibration, number).mean():>5.0f}%{degrees:>8.3f}"
            f"{1000 * metres:>7.1f}{1000 * offset:>11.2f}{offset / calibration.periods[number]:>8.2f}"
        )
    rms, median = calibration.rms(), calibration.median()
    lines.append(f"{'all':<16}{len(calibration.times):>9}{len(calibration.misses):>9}{rms:>8.3f}{median:>8.3f}")
    return "\n".join(lines)


def advice_of(calibration: Calibration) -> Iterator[str]:
    """Sentences about what is weak, and where the world lies."""
    names = [camera.name for camera in calibration.cameras]
    for number, name in enumerate(names):
        cells = _cells(calibration, number)
        if cells.mean() < _WEAK_SEEN:
            seen = cells.reshape(2, DOWN // 2, 2, ACROSS // 2).mean(axis=(1, 3))  # of each quarter
            yield (
                f"{name} saw the board in {100 * cells.mean():.0f} % of its picture, least in its "
                f"{QUARTERS[seen.argmin()]}: walk the board there to know its lens better"
            )
        degrees, metres = calibration.errors[number]
        if degrees > _WEAK_DEGREES:
            yield (
                f"{name} is known to {degrees:.2f} degrees and {1000 * metres:.0f} mm only: walk longer, and "
                "nearer to it, where another camera sees the board too"
            )
        if calibration.rms(number) > _WEAK_PIXELS:
            yield (
                f"{name} has a reprojection error of {calibration.rms(number):.1f} pixels: blur, a board that "
                "is not flat, or pictures at other times than stated"
            )
    if guessed := np.flatnonzero(calibration.guessed).tolist():
        yield (
            f"{spoken(names[number] for number in guessed)}: the offset may be wrong by a frame or more, as the board "
            "was held still where another camera saw it too; walk it there without a stop, or clap once where all hear "
            "it"
        )
    if uneven := {number: seconds for number, seconds in enumerate(calibration.uneven) if seconds > _WEAK_SECONDS}:
        yield (
            f"{spoken(names[number] for number in uneven)}: pictures were taken up to "
            f"{1000 * max(uneven.values()):.0f} ms earlier or later than their times say, which the calibration allows "
            "for: end other programs, or film at a constant rate"
        )
    read = np.abs(calibration.readouts).max(axis=1)
    if slow := [number for number, seconds in enumerate(read) if seconds > _SLOW_READOUT]:
        yield (
            f"{spoken(names[number] for number in slow)}: a picture is read line by line in up to "
            f"{1000 * read.max():.0f} ms, which the calibration allows for; what moves fast is slanted in it"
        )
    if calibration.floor_by_board:
        yield "the floor is where the board lay: z = 0 there, z up, metres"
    else:
        yield (
            "z is up as the cameras are held, and 0 at the lowest place of the board; lay the board on the floor for "
            "three seconds to have the true floor"
        )


def draw(calibration: Calibration, path: Path) -> None:
    """Write a PNG: the rig from above, and each camera's corners, coloured by how far they lie off."""
    from matplotlib.figure import Figure

    count = len(calibration.cameras)
    columns = min(4, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(3.2 * columns + 5, max(5, 2.6 * rows)), layout="constrained")
    whole, cells = np.ravel(figure.subfigures(1, 2, squeeze=False, width_ratios=(5, 3.2 * columns)))
    _draw_rig(calibration, whole.subplots())
    panels = np.atleast_1d(cells.subplots(rows, columns, squeeze=False)).ravel()
    for number, axes in enumerate(panels):
        axes.set_xticks([])
        axes.set_yticks([])
        if number < count:
            _draw_camera(calibration, number, axes)
        else:
            axes.set_axis_off()
    file = BytesIO()
    figure.savefig(file, format="png")
    write_bytes(path, file.getvalue())


def _draw_rig(calibration: Calibration, axes: Axes) -> None:
    axes.plot(*calibration.boards[:, :2].T, ".", color="0.7", markersize=3, label="board")
    for camera in calibration.cameras:
        x, y = camera.centre[:2]
        ahead = camera.world_to_camera[2, :2]
        axes.arrow(x, y, 0.4 * ahead[0], 0.4 * ahead[1], width=0.01, head_width=0.08, color="C0")
        axes.annotate(f"{camera.name}\n{camera.centre[2]:.2f} m up", (x, y), fontsize=7)
    axes.set_aspect("equal")
    axes.margins(0.15)
    axes.set_xlabel("x, metres")
    axes.set_ylabel("y, metres")
    axes.set_title("from above", fontsize=9)


def _draw_camera(calibration: Calibration, number: int, axes: Axes) -> None:
    camera, mine = calibration.cameras[number], calibration.seen.camera == number
    miss = np.linalg.norm(calibration.misses[mine], axis=1)
    x, y = calibration.seen.value[mine].T
    axes.scatter(x, y, c=miss, s=3, cmap="viridis", vmin=0, vmax=1.5)
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height, 0)
    axes.set_aspect("equal")
    axes.set_title(f"{camera.name}: {calibration.rms(number):.2f} px", fontsize=8)


def _cells(calibration: Calibration, number: int) -> Float64:
    """[DOWN,ACROSS] 1 for the cells of a camera's picture in which corners were seen."""
    camera, found = calibration.cameras[number], np.zeros((DOWN, ACROSS))
    points = calibration.seen.value[calibration.seen.camera == number]
    across, down = cell_numbers(points, (camera.width, camera.height))
    found[down, across] = 1
    return found
