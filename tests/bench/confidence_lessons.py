"""What the network that says which depths to believe learns from: pixels of the choosing half of the zoo.

    python -m tests.bench.confidence_lessons --data DATA --out LESSONS

Synthetic kinds, whose depth is known: as they are, under other exposures, and with noise and cameras that are a little
off. Recordings: a depth that few cameras measure is compared with what all cameras but the held-out one measure there.
One file a choice of cameras; those that are there are not made again, so name an empty folder after a change here.
"""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.data import Dataset, linspace_split
from streamlod.core.initialise.confidence.evidence import Matches, evidence
from streamlod.core.initialise.consistency import knowing, votes
from streamlod.core.initialise.methods.plane_sweep import ROWS, swept
from streamlod.core.initialise.stereo.sweep import DepthMap
from streamlod.core.initialise.views import WorkingViews, working_views
from streamlod.core.synthetic import ground_truth, open_synthetic
from tests.bench.zoo.scenes import SCENES, ZooScene

_LOG = logging.getLogger(__name__)
_DOWNSCALE = 2.0
_VIEWS = (3, 4, 6, 9)
_DRAWN = (3, 4, 6)  # numbers of neighbouring cameras drawn at random from a recording, each `_DRAWS` times
_DRAWS = 2
_TOLERANCE = 0.02  # relative, of depths of other cameras that agree
_VERSIONS = (
    (0, 0.0, 1.0, 0.0),
    (1, 0.3, 2.0, 0.15),
    (2, 0.0, 6.0, 0.4),
)  # of a synthetic kind: seed, spread of exposures in stops, noise in grey levels, pixels by which cameras are off


@dataclass(frozen=True, slots=True)
class Choice:
    """Some cameras of a scene. scene: its name. version: of a synthetic kind. cameras: their names."""

    scene: str
    version: int
    cameras: tuple[str, ...]

    @property
    def file(self) -> str:
        """Its file's name."""
        return "-".join([self.scene, str(self.version), *self.cameras]) + ".npz"


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """P pixels of one choice of cameras.

    Attributes:
        scene: its name. views: how many cameras.
        evidence: [P,F]. trusted: [P], the tests let it pass.
        error: [P] depth over the true depth, less one; NaN where nobody knows.
    """

    scene: str
    views: int
    evidence: Float32
    trusted: Bool
    error: Float32


def _choosing() -> dict[str, ZooScene]:
    return {scene.name: scene for scene in SCENES if scene.half == "choosing"}


def choices(data: Path) -> Iterator[Choice]:
    """All that is learnt from."""
    generator = np.random.default_rng(0)
    for name, scene in _choosing().items():
        whole = scene.open(data, _DOWNSCALE)
        if whole is None:
            _LOG.warning("%s is left out: it is not under %s", name, data)
            continue
        synthetic = scene.spec(_DOWNSCALE) is not None
        for version in range(len(_VERSIONS) if synthetic else 1):
            for views in _VIEWS:
                yield Choice(name, version, linspace_split(whole.names, views, (scene.held_out,)).train)
        others = [camera for camera in whole.names if camera != scene.held_out]
        for views in () if synthetic else _DRAWN * _DRAWS:
            # from neighbours: cameras that are spread over the whole rig are those of `linspace_split`
            first = int(generator.integers(len(others)))
            near = sorted(range(len(others)), key=lambda other: abs(other - first))[: 2 * views]
            yield Choice(name, 0, tuple(others[index] for index in sorted(generator.permutation(near)[:views])))


def write_lesson(data: Path, folder: Path, choice: Choice) -> str:
    """Makes one lesson's file if it is not there; its name."""
    path = folder / choice.file
    if path.exists():
        return choice.file
    scene = _choosing()[choice.scene]
    lesson = _recorded(data, scene, choice) if scene.spec(_DOWNSCALE) is None else _synthetic(scene, choice)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(file, evidence=lesson.evidence, trusted=lesson.trusted, error=lesson.error)
    part.rename(path)
    return choice.file


def read_lessons(folder: Path) -> list[Lesson]:
    """All that `folder` has."""
    found = []
    for path in sorted(folder.glob("*.npz")):
        scene, _, *cameras = path.stem.split("-")
        with np.load(path, allow_pickle=False) as arrays:
            found.append(Lesson(scene, len(cameras), arrays["evidence"], arrays["trusted"], arrays["error"]))
    return found


def _lesson(choice: Choice, matches: Matches, error: list[Float64]) -> Lesson:
    return Lesson(
        choice.scene,
        len(choice.cameras),
        np.concatenate(evidence(matches)),
        np.concatenate([good.ravel() for good in matches.trusted]),
        np.concatenate([found.ravel() for found in error]).astype(np.float32),
    )


def _synthetic(scene: ZooScene, choice: Choice) -> Lesson:
    seed, exposure_spread, noise, off = _VERSIONS[choice.version]
    plain = scene.spec(_DOWNSCALE)
    assert plain is not None
    spec = replace(plain, seed=seed, exposure_spread=exposure_spread, noise=noise)
    whole = open_synthetic(spec)
    part = whole.select(choice.cameras)
    views = working_views(next(iter(part.frames(0, 1))), part.cameras, ROWS)
    matches, errors = swept(_off(views, off), whole.depth_bounds), []
    for name, depth_map in zip(choice.cameras, matches.maps, strict=True):
        height, width = depth_map.depth.shape
        truth = ground_truth(spec, 0, whole.names.index(name)).depth
        truth = np.asarray(cv2.resize(truth, (width, height), interpolation=cv2.INTER_NEAREST), np.float32)
        errors.append(np.asarray(depth_map.depth / truth - 1, np.float64))
    return _lesson(choice, matches, errors)


def _off(views: WorkingViews, pixels: float) -> WorkingViews:
    """Cameras that are turned by about so many pixels, as those of a calibration are."""
    generator = np.random.default_rng(7)

    def turned(camera: Camera) -> Camera:
        angles = generator.standard_normal(3) * pixels / camera.intrinsics[1, 1]
        turn = np.eye(4)
        turn[:3, :3] = cv2.Rodrigues(angles)[0]
        return replace(camera, world_to_camera=turn @ camera.world_to_camera)

    return replace(views, cameras=tuple(map(turned, views.cameras)))


@lru_cache(maxsize=1)
def _all(data: Path, name: str) -> tuple[Dataset, dict[str, tuple[DepthMap, Bool]]]:
    """A recording, and what each camera measures with the help of all but the held-out one."""
    scene = _choosing()[name]
    whole = scene.open(data, _DOWNSCALE)
    assert whole is not None
    names = tuple(camera for camera in whole.names if camera != scene.held_out)
    matches = _matches(whole, names)
    return whole, dict(zip(names, zip(matches.maps, matches.trusted, strict=True), strict=True))


def _matches(whole: Dataset, names: tuple[str, ...]) -> Matches:
    part = whole.select(names)
    return swept(working_views(next(iter(part.frames(0, 1))), part.cameras, ROWS), whole.depth_bounds)


def _recorded(data: Path, scene: ZooScene, choice: Choice) -> Lesson:
    whole, every = _all(data, scene.name)
    matches, errors = _matches(whole, choice.cameras), []
    for name, depth_map in zip(choice.cameras, matches.maps, strict=True):
        others = [pair for other, pair in every.items() if other != name]
        sure = knowing([known for known, _ in others], [good for _, good in others])
        agreeing, through = (
            count.reshape(depth_map.depth.shape) for count in votes(depth_map.points(), -1, sure, _TOLERANCE)
        )
        known, good = every[name]
        difference = depth_map.depth / known.depth - 1
        # wrong is what differs from what all cameras together have there, even where they are not sure; then what two
        # others look through; right is what all are sure of, or where nobody is, what two others see
        error = np.where(good | (np.abs(difference) > 2 * _TOLERANCE), difference, np.nan)
        error = np.where(np.isnan(error) & (through >= 2) & (through > agreeing), -2 * _TOLERANCE, error)
        errors.append(np.where(np.isnan(error) & (agreeing >= 2) & (through == 0), 0.0, error))
    return _lesson(choice, matches, errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, required=True, help="the folder of the recordings")
    parser.add_argument("--out", type=Path, required=True, help="the folder of the lessons")
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    options.out.mkdir(parents=True, exist_ok=True)
    wanted = list(dict.fromkeys(choices(options.data)))
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        count = len(wanted)
        for done in pool.map(write_lesson, [options.data] * count, [options.out] * count, wanted):
            print(done, flush=True)


if __name__ == "__main__":
    main()
