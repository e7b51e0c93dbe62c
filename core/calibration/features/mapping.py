"""Poses and lenses from features, by COLMAP's incremental mapping (Schoenberger and Frahm, Structure-from-motion
revisited, 2016), of which the package pycolmap is used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.projection import matrix_of
from streamlod.core.calibration.checks.matches import Features, alike
from streamlod.core.data.names import spoken
from streamlod.core.errors import BackendUnavailable, InputError

_FOCAL = 0.9  # of the longer side, where the search for it begins: phones and webcams have 0.6 to 1.2
_MIN_MATCHES, _MIN_POSE = 15, 12  # features that two cameras share, and that place a camera
_MIN_FIRST, _MIN_ANGLE = 30, 4.0  # features of the first pair, and degrees between its rays
_QUIET = 3  # level of COLMAP's own log: fatal faults


@dataclass(frozen=True, slots=True, eq=False)
class MappedCamera:
    """A camera that was placed.

    Attributes:
        matrix: [3,3] intrinsics in OpenCV's convention. distortion: [5]. pose: [6] world to camera.
        count: features that place it. miss: pixels by which they miss, root mean square.
    """

    matrix: Float64
    distortion: Float64
    pose: Float64
    count: int
    miss: float


def mapped(
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    features: Sequence[Sequence[Features]],
    known: Mapping[str, Float64],
    on_step: Callable[[], object],
) -> tuple[tuple[MappedCamera, ...], Float64]:
    """The cameras, and [P,3] points that they see, in axes and units of no meaning.

    Args:
        features: of each camera, those of its instants. known: lenses [9] by name that are kept.
        on_step: called once for each pair of cameras that was compared and for each camera that was placed; COLMAP
            may begin anew, and calls it then for more cameras than there are.
    """
    colmap = _colmap()
    pairs = {}
    for a, b in combinations(range(len(names)), 2):
        pairs[a, b] = _matches(features[a], features[b])
        on_step()
    with TemporaryDirectory() as folder:
        database = Path(folder) / "features.db"
        _write(colmap, database, names, sizes, features, known, pairs)
        listed = Path(folder) / "pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
        colmap.verify_matches(str(database), str(listed))
        options = _options(colmap, {row + 1 for row, name in enumerate(names) if name in known})
        models = colmap.incremental_mapping(
            str(database), folder, folder, options, initial_image_pair_callback=on_step, next_image_callback=on_step
        )
    best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
    placed = {} if best is None else {int(image.name): image for image in best.images.values() if image.has_pose}
    if best is None or len(placed) < len(names):
        raise _apart(names, set(placed), pairs)
    points = np.array([point.xyz for point in best.points3D.values()])
    return tuple(_placed(best, placed[number], known.get(name)) for number, name in enumerate(names)), points


def _colmap() -> Any:
    try:
        import pycolmap
    except ImportError as error:
        raise BackendUnavailable(
            "calibration without a board", "install it: pip install 'streamlod[features]'"
        ) from error
    pycolmap.logging.minloglevel = _QUIET
    return pycolmap


def _options(colmap: Any, constant: set[int]) -> Any:
    options = colmap.IncrementalPipelineOptions()
    options.min_num_matches, options.min_model_size, options.multiple_models = _MIN_MATCHES, 2, False
    options.constant_cameras = constant
    options.extract_colors, options.random_seed = False, 0
    options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = _MIN_POSE, 0.1
    options.mapper.init_min_num_inliers, options.mapper.init_min_tri_angle = _MIN_FIRST, _MIN_ANGLE
    return options


def _write(
    colmap: Any,
    path: Path,
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    features: Sequence[Sequence[Features]],
    known: Mapping[str, Float64],
    pairs: Mapping[tuple[int, int], Int64],
) -> None:
    """A database of COLMAP with an image of each camera, called by its number, with features of all instants."""
    database = colmap.Database.open(str(path))
    images = []
    for number, (name, size) in enumerate(zip(names, sizes, strict=True)):
        camera = database.write_camera(_lens(colmap, size, known.get(name)))
        sensor = colmap.sensor_t(colmap.SensorType.CAMERA, camera)
        rig = colmap.Rig()
        rig.add_ref_sensor(sensor)
        image, frame = colmap.Image(), colmap.Frame()
        image.name, image.camera_id = str(number), camera
        images.append(database.write_image(image))
        frame.rig_id = database.write_rig(rig)
        frame.add_data_id(colmap.data_t(sensor, images[number]))
        database.write_frame(frame)
        database.write_keypoints(
            images[number], np.concatenate([each.points for each in features[number]]).astype(np.float32)
        )
    for (a, b), rows in pairs.items():
        database.write_matches(images[a], images[b], rows.astype(np.uint32))
    database.close()


def _lens(colmap: Any, size: tuple[int, int], known: Float64 | None) -> Any:
    width, height = size
    model, params = "SIMPLE_RADIAL", [_FOCAL * max(size), width / 2, height / 2, 0.0]
    if known is not None:
        model, params = "FULL_OPENCV", [*known[:2], *(known[2:4] + 0.5), *known[4:9], 0.0, 0.0, 0.0]
    camera = colmap.Camera(model=model, width=width, height=height, params=params)
    camera.has_prior_focal_length = known is not None
    return camera


def _matches(one: Sequence[Features], other: Sequence[Features]) -> Int64:
    """[M,2] features that are alike at one instant, counted through all instants of each camera."""
    found, first = [np.zeros((0, 2), np.int64)], np.zeros(2, np.int64)
    for a, b in zip(one, other, strict=True):
        found.append(alike(a, b) + first)
        first = first + np.array([len(a.points), len(b.points)])
    return np.concatenate(found)


def _placed(model: Any, image: Any, known: Float64 | None) -> MappedCamera:
    camera = model.cameras[image.camera_id]
    if known is None:
        focal, x, y, bend = camera.params
        known = np.array([focal, focal, x - 0.5, y - 0.5, bend, 0, 0, 0, 0])
    seen = [point for point in image.points2D if point.has_point3D()]
    pose = image.cam_from_world()
    world = np.array([model.points3D[point.point3D_id].xyz for point in seen])
    there = np.array([image.project_point(each) for each in world], np.float64)
    misses = np.linalg.norm(there - np.array([point.xy for point in seen]), axis=1)
    return MappedCamera(
        matrix_of(known), known[4:], rigid.pose(np.vstack([pose.matrix(), [0, 0, 0, 1]])), len(seen),
        float(np.sqrt((misses**2).mean())),
    )  # fmt: skip


def _apart(names: Sequence[str], placed: set[int], pairs: Mapping[tuple[int, int], Int64]) -> InputError:
    """Cameras that were not placed, and how much they share with others."""
    outside = [number for number in range(len(names)) if number not in placed] if placed else list(range(len(names)))
    most = max(len(rows) for pair, rows in pairs.items() if set(pair) & set(outside))
    cameras = spoken((names[number] for number in outside), 8)
    return InputError(
        f"camera{'s' if len(outside) > 1 else ''} {cameras}",
        f"see too little of what the others see: at most {most} features look alike in two cameras, many of them by "
        "chance; put cameras nearer together (20 degrees), add one between, or walk a board",
    )
