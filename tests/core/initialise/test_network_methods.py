"""First points by networks: what Depth Anything 3 is told, by a stand-in of its interface, and what is said without."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.errors import BackendUnavailable
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.initialise.plugins.depth_anything import DepthAnythingPoints, poses_to_tell
from streamlod.core.initialise.views import inside, project
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic

SPEC = SyntheticSpec(cameras=4, frames=1, width=112, height=70)
DATASET = open_synthetic(SPEC)
OWN_UNIT = 3.7  # metres per unit of what the stand-in predicts without poses


@cache  # drawn by the first test: every process of tests reads this module
def first_frame() -> FrameSet:
    return next(iter(DATASET.frames()))


@cache
def true_depths() -> list[np.ndarray]:
    return [ground_truth(SPEC, 0, index).depth for index in range(SPEC.cameras)]


@dataclass
class Prediction:
    depth: np.ndarray
    conf: np.ndarray
    extrinsics: np.ndarray


class StandIn:
    """Depth Anything 3 as far as it is used: true depths of the first cameras of the clip, in the unit of the poses."""

    loaded: tuple[str, dict[str, Any]]
    told: dict[str, Any]

    @classmethod
    def from_pretrained(cls, name: str, **options: Any) -> StandIn:
        cls.loaded = name, options
        if name == "missing":
            raise FileNotFoundError(name)
        return cls()

    def to(self, device: str) -> StandIn:
        return self

    def eval(self) -> StandIn:
        return self

    def inference(self, image: Sequence[np.ndarray], extrinsics: np.ndarray | None, **options: Any) -> Prediction:
        type(self).told = {"image": image, "extrinsics": extrinsics, **options}
        sys.stdout.write("the package says what it does\n")
        height, width = image[0].shape[:2]
        poses = np.stack([camera.world_to_camera for camera in DATASET.cameras[: len(image)]])[:, :3]
        told = np.linalg.norm(poses[0, :, 3]) / OWN_UNIT if extrinsics is None else np.linalg.norm(extrinsics[0, :3, 3])
        unit = np.linalg.norm(poses[0, :, 3]) / told
        poses[:, :, 3] /= unit
        depth = np.stack([cv2.resize(each, (width, height), interpolation=cv2.INTER_NEAREST) for each in true_depths()])
        depth = (depth[: len(image)] / unit).astype(np.float32)
        confidence = np.random.default_rng(2).random(depth.shape).astype(np.float32) + 1
        return Prediction(depth, confidence, poses.astype(np.float32))


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[StandIn]:
    package, api = ModuleType("depth_anything_3"), ModuleType("depth_anything_3.api")
    api.DepthAnything3 = StandIn  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "depth_anything_3", package)
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", api)
    return StandIn


def surface_error(positions: np.ndarray) -> np.ndarray:
    """[N] the least relative distance, over the cameras, between a point's depth and the true depth there."""
    error = np.full(len(positions), np.inf)
    for camera, truth in zip(DATASET.cameras, true_depths(), strict=True):
        pixels, z = project(camera, positions.astype(np.float64))
        seen = inside(camera, pixels, z)
        column, row = pixels[seen].astype(int).T
        error[seen] = np.minimum(error[seen], np.abs(z[seen] / truth[row, column] - 1))
    return error


@pytest.mark.long
def test_depths_with_known_poses_become_points_on_the_surfaces(
    stand_in: type[StandIn], capsys: pytest.CaptureFixture[str]
) -> None:
    points = first_points(first_frame(), DATASET.cameras, depth_bounds=None, method="depth-anything")
    assert len(points) > 100_000
    assert (surface_error(points.positions) < 0.03).mean() > 0.9
    assert stand_in.loaded == ("depth-anything/DA3-BASE", {"local_files_only": True})
    told = stand_in.told
    assert [picture.shape for picture in told["image"]] == [(308, 504, 3)] * 4
    assert told["image"][0].dtype == np.uint8
    assert told["process_res"] == 504  # the size that the pictures have already
    expected = DATASET.cameras[2].intrinsics * np.array([[504 / 112], [308 / 70], [1]])
    np.testing.assert_allclose(told["intrinsics"][2], expected)
    rotations = np.stack([camera.world_to_camera[:3, :3] for camera in DATASET.cameras])
    np.testing.assert_array_equal(told["extrinsics"][:, :3, :3], rotations)
    assert capsys.readouterr().out == ""


def test_two_cameras_are_placed_without_telling_poses(stand_in: type[StandIn]) -> None:
    present = np.array([True, True, False, False])
    frame = FrameSet(0, 0, first_frame().images, present)
    points = first_points(frame, DATASET.cameras, depth_bounds=None, method="depth-anything")
    assert (surface_error(points.positions) < 0.03).mean() > 0.9
    assert stand_in.told["extrinsics"] is None
    assert stand_in.told["intrinsics"] is None


def rig(centres: np.ndarray) -> list[Camera]:
    target, up = np.array([0.0, 0, 1e5]), np.array([0.0, -1, 0])
    return [pinhole("c", (50, 50), (10, 5), (20, 10), look_at(at, target, up)) for at in centres]


def test_poses_are_told_in_a_unit_of_the_rig() -> None:
    centres = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.7, 0]])
    for size in (0.01, 1000.0):
        poses = poses_to_tell(rig(size * centres))
        assert poses is not None
        found = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
        assert np.linalg.norm(found - found.mean(axis=0), axis=1).mean() == pytest.approx(1)


@pytest.mark.parametrize("count", [2, 5])
def test_poses_on_a_line_are_not_told(count: int) -> None:
    assert poses_to_tell(rig(np.outer(np.arange(count), [1.0, 0.2, 0]))) is None


def test_missing_weights_are_said_in_one_sentence(stand_in: type[StandIn]) -> None:
    with pytest.raises(BackendUnavailable, match=r"model missing is not available here; .*`hf download missing`"):
        first_points(first_frame(), DATASET.cameras, depth_bounds=None, method=DepthAnythingPoints("missing"))


@pytest.mark.parametrize(
    ("method", "module", "package"),
    [("vggt", "vggt", "vggt"), ("depth-anything", "depth_anything_3", "depth-anything-3")],
)
def test_missing_packages_are_said_in_one_sentence(method: str, module: str, package: str) -> None:
    if importlib.util.find_spec(module) is not None:
        pytest.skip(f"{package} is installed here")
    with pytest.raises(BackendUnavailable, match=rf"{package} is not available here; install it .* or use sweep"):
        first_points(first_frame(), DATASET.cameras, depth_bounds=None, method=method)
