"""The command `streamlod calibrate --features`: without a board; returns the text to print."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from streamlod.core.data.names import spoken
from streamlod.core.errors import InputError
from streamlod.core.files import write_text
from streamlod.core.progress_bar import progress_bar
from streamlod.server.cli.calibrate import REPORT, known_lenses

if TYPE_CHECKING:
    from streamlod.core.arrays import Float64, UInt8
    from streamlod.core.calibration.features.solve import FeatureCalibration
    from streamlod.core.calibration.walk import WalkFootage

_INSTANTS = 12  # spread over what all cameras filmed
_MOST = 8000  # features of a picture
_FEW = 100  # features below which a camera's pose is a guess


def calibrate_features(data: Path, out: Path | None, apart: str | None, lenses: Path | None, overwrite: bool) -> str:
    """Calibrate cameras from what they see alike."""
    from streamlod.core.calibration.checks.matches import features_of
    from streamlod.core.calibration.features.solve import calibrate_by_features
    from streamlod.core.calibration.files import check_folder, write_calibration
    from streamlod.core.calibration.sound.walk import unlike_clocks, walk_offsets
    from streamlod.core.calibration.walk import open_walk

    footage, folder = open_walk(data), data if out is None else out
    measured = None if apart is None else _measured(apart, [each.camera for each in footage])
    known = {} if lenses is None else known_lenses(lenses, footage)
    check_folder(folder, overwrite=overwrite)
    heard = walk_offsets(footage)
    offsets = unlike_clocks(footage, heard)
    timed = [replace(each, times=each.times + offset) for each, offset in zip(footage, offsets, strict=True)]
    instants = _instants(timed)
    cameras = progress_bar(timed, unit="camera", desc="looking for features")
    features = [[features_of(picture, _MOST) for picture in _at(each, instants)] for each in cameras]
    count = len(footage)
    steps = count * (count - 1) // 2 + count - 1  # pairs that are compared, and cameras that are placed after the first
    with progress_bar(total=steps, unit="step", desc="placing the cameras") as bar:
        found = calibrate_by_features(footage, features, offsets, known, bar.update)
    if measured is not None:
        one, other, metres = measured
        found = found.scaled(metres / found.apart(one, other))
    files = write_calibration(found, footage, folder)
    report = "\n".join([_table(found), *_advice(found, measured is not None), _clocks(found, heard)])
    write_text(folder / REPORT, report + "\n")
    return f"{report}\n{', '.join(file.name for file in files)} and {REPORT} written to {folder}"


def _measured(apart: str, names: Sequence[str]) -> tuple[str, str, float]:
    match = re.fullmatch(r"(.+):(.+)=(\d+(?:\.\d+)?)", apart)
    if match is None or not 0.01 <= float(match[3]) <= 1000:
        raise InputError("--apart", f"{apart!r:.60} is not CAMERA:CAMERA=METRES, such as {names[0]}:{names[1]}=1.85")
    if not {match[1], match[2]} <= set(names) or match[1] == match[2]:
        raise InputError("--apart", f"{apart!r:.60} does not name two of the cameras {', '.join(names)[:200]}")
    return match[1], match[2], float(match[3])


def _instants(footage: Sequence[WalkFootage]) -> list[float]:
    """Seconds that all cameras filmed, evenly spread; InputError if there are none."""
    first, last = max(each.times[0] for each in footage), min(each.times[-1] for each in footage)
    if last < first:
        raise InputError("calibrate", "the videos' times have nothing in common; film all cameras at once")
    return [float(each) for each in np.linspace(first, last, min(_INSTANTS, *(len(each.times) for each in footage)))]


def _at(footage: WalkFootage, instants: Sequence[float]) -> Iterator[UInt8]:
    """The pictures of one camera that are nearest to these instants."""
    rows = [int(np.abs(footage.times - instant).argmin()) for instant in instants]
    wanted, pictures = set(rows), {}
    for row, picture in enumerate(islice(footage.pictures(), max(rows) + 1)):
        if row in wanted:
            if picture is None or picture.shape[1::-1] != footage.size:
                raise InputError(f"camera {footage.camera}", f"its picture {row} is missing or of another size")
            pictures[row] = picture
    return (pictures[row] for row in rows)


def _table(found: FeatureCalibration) -> str:
    lines = [f"{'camera':<16}{'features':>9}{'rms px':>8}{'focal px':>10}{'offset ms':>11}"]
    for number, camera in enumerate(found.cameras):
        focal = camera.intrinsics[0, 0]
        figures = (
            f"{found.counts[number]:>9}{found.rms(number):>8.2f}{focal:>10.1f}{1000 * found.offsets[number]:>11.0f}"
        )
        lines.append(f"{camera.name[-15:]:<16}{figures}")
    return "\n".join(lines)


def _advice(found: FeatureCalibration, measured: bool) -> Iterator[str]:
    for camera, count in zip(found.cameras, found.counts, strict=True):
        if count < _FEW:
            yield (
                f"{camera.name} is placed by {count} features only, and may be degrees off: put a camera between it "
                "and the next one, keep its lens with --lenses, or walk a board"
            )
    if not measured:
        yield (
            "no length is known: one unit is a third of the distance of the cameras from what they see; measure two "
            f"cameras from lens to lens and give --apart {found.cameras[0].name}:{found.cameras[1].name}=METRES"
        )
    yield "z is up as the cameras are held, and 0 at the lowest that they see"


def _clocks(found: FeatureCalibration, heard: Float64) -> str:
    """A sentence on what became of the clocks, of which sound tells `heard` [C]."""
    names = [camera.name for camera in found.cameras]
    alike = [name for name, each in zip(names, heard, strict=True) if np.isfinite(each)]
    others = [name for name in names if name not in alike]
    if not alike:
        return "clocks are taken as they are, as no two cameras heard the same; clap once while all film to change that"
    if not found.offsets.any():
        told = f"by what {spoken(alike)} heard, their clocks agree, and are taken as they are"
    else:
        told = f"offsets are those of what {spoken(alike)} heard, good to 3 ms a metre"
    return f"{told}; of {spoken(others)} sound tells nothing" if others else told
