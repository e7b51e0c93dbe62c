"""A live rig as its JSON file describes it: cameras, calibration, where pictures come from, and how they are paired.

    {"fps": 30, "policy": "require_all",
     "cameras": [{"name": "cam00", "source": "rtsp://10.0.0.10/main", "width": 1920, "height": 1080,
                  "intrinsics": [[1100, 0, 960], [0, 1100, 540], [0, 0, 1]], "distortion": [0, 0, 0, 0, 0],
                  "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}

With ``"calibration": "FOLDER"`` the cameras' geometry, points and depth range come from a calibrated data set, and
cameras need a name and a source only.
"""

from __future__ import annotations

import json
import logging
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictBool, ValidationError

from streamlod.core.camera import Camera
from streamlod.core.camera.space import UNCHANGED, Similarity, training_space
from streamlod.core.data import open_dataset
from streamlod.core.data.dataset import RawRecording
from streamlod.core.data.files import read_bytes
from streamlod.core.data.pictures import MAX_SIDE
from streamlod.core.data.sources import Videos
from streamlod.core.errors import InputError
from streamlod.core.field_faults import first_fault, matching
from streamlod.core.frames import PointCloud
from streamlod.core.options import MAX_CAMERAS
from streamlod.server.ingest.cameras.address import CAMERA_NAME, CAMERA_NAME_WORDS, PUSH, Address, parse_address
from streamlod.server.ingest.cameras.sound_source import SoundSource, choose_sound

_LOG = logging.getLogger(__name__)

_MAX_BYTES = 1 << 20
_MAX_OFFSET_MS = 60_000.0
_Row3 = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _CameraEntry(_Strict):
    name: Annotated[str, BeforeValidator(matching(CAMERA_NAME, CAMERA_NAME_WORDS))] = Field(pattern=f"^{CAMERA_NAME}$")
    source: str
    width: int | None = Field(default=None, ge=1, le=MAX_SIDE)
    height: int | None = Field(default=None, ge=1, le=MAX_SIDE)
    intrinsics: tuple[_Row3, _Row3, _Row3] | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    world_to_camera: tuple[_Row4, _Row4, _Row4, _Row4] | None = None
    offset_ms: float = Field(default=0.0, ge=-_MAX_OFFSET_MS, le=_MAX_OFFSET_MS)


class _Quorum(_Strict):
    quorum: int = Field(ge=1)


def _checked_policy(value: object) -> object:
    """Refuse what is neither of the two in one sentence."""
    quorum = value["quorum"] if isinstance(value, dict) and set(value) == {"quorum"} else None
    if value != "require_all" and not (type(quorum) is int and quorum >= 1):
        raise ValueError(f'must be "require_all" or {{"quorum": N}} with N of at least 1, not {value!r:.80}')
    return value


class _File(_Strict):
    fps: float = Field(gt=0, le=1000)
    policy: Annotated[Literal["require_all"] | _Quorum, BeforeValidator(_checked_policy)] = "require_all"
    realtime: StrictBool = True
    calibration: Path | None = None
    depth_bounds: tuple[float, float] | None = None
    sound: str | None = Field(default=None, min_length=1, max_length=2048)
    cameras: Annotated[tuple[_CameraEntry, ...], Field(min_length=1, max_length=MAX_CAMERAS)]


@dataclass(frozen=True, slots=True, eq=False)
class RigDefinition:
    """A live rig.

    Attributes:
        path: file that describes it, or a name for it.
        cameras: as calibrated, distortion included; pixel centres at half-integers.
        addresses: where each camera's pictures come from.
        fps: instants a second.
        quorum: cameras that an instant needs.
        realtime: whether files are played at their pace, as cameras would deliver.
        space: from the calibration's coordinates to those of training.
        depth_bounds: nearest and farthest depth of the scene in the calibration's units, or none.
        read_points: reads the points that came with the calibration into a space, or none.
        sound: what is heard; None for nothing.
        offsets_ns: nanoseconds that are added to the times of a camera's pictures, by its name: what the file says, and
            what a board walk that these cameras recorded live has shown beside that. Others have none.
    """

    path: Path
    cameras: tuple[Camera, ...]
    addresses: tuple[Address, ...]
    fps: float
    quorum: int
    space: Similarity
    realtime: bool = True
    depth_bounds: tuple[float, float] | None = None
    read_points: Callable[[Similarity], PointCloud] | None = None
    sound: SoundSource | None = None
    offsets_ns: Mapping[str, int] = field(default_factory=dict)

    @property
    def sound_name(self) -> str:
        """The source of sound as the file names it; empty for none."""
        return "" if self.sound is None else self.sound.name

    @property
    def microphone(self) -> str | None:
        """The camera at which the sound is heard; None for a microphone or a file of its own, and for none."""
        return self.sound_name if any(camera.name == self.sound_name for camera in self.cameras) else None


def read_definition(source: Path | dict[str, Any]) -> RigDefinition:
    """The rig that a file describes, or a mapping of the same form.

    Relative paths are taken from the file's folder, those of a mapping from the working directory.

    Raises:
        InputError: the file cannot be read, a field is wrong or missing, or the rig is not usable.
    """
    path, file = _read(source)
    names = [entry.name for entry in file.cameras]
    quorum = len(names) if file.policy == "require_all" else file.policy.quorum
    if quorum > len(names):
        raise InputError(path, f"asks for a quorum of {quorum} with {len(names)} cameras; ask for fewer")
    bounds = file.depth_bounds
    if bounds is not None and not 0 < bounds[0] < bounds[1]:
        raise InputError(path, "depth_bounds must be two depths, the nearer one first")
    addresses = _addresses(path, file)
    if not file.realtime and any(address.is_live for address in addresses):
        raise InputError(path, "realtime can be false only where all sources are files")
    if file.calibration is None:
        cameras = calibrated = tuple(_camera(path, entry) for entry in file.cameras)
        read_points, walked = None, dict[str, int]()
    else:
        recording = open_dataset(path.parent / file.calibration).recording
        calibrated, read_points = recording.cameras, recording.read_points
        known = {camera.name: camera for camera in calibrated}
        cameras = tuple(_known(path, entry, known) for entry in file.cameras)
        bounds, walked = bounds or recording.depth_bounds, _offsets(recording)
    space = training_space(calibrated, bounds)
    sound = _sound(path, file, addresses)
    stated = _stated(file)
    offsets = {name: stated.get(name, 0) + walked.get(name, 0) for name in {**stated, **walked}}
    return RigDefinition(
        path, cameras, addresses, file.fps, quorum, space, file.realtime, bounds, read_points, sound, offsets
    )


def read_uncalibrated(path: Path) -> RigDefinition:
    """The rig of a file whose cameras are not calibrated yet: names, sources and sizes are as there, all else is not.

    Its lenses and poses are placeholders, and instants are used with any one camera.

    Raises:
        InputError: as `read_definition`, or a camera's size is missing.
    """
    _, file = _read(path)
    cameras = []
    for entry in file.cameras:
        if entry.width is None or entry.height is None:
            raise InputError(path, f"camera {entry.name} needs width and height, the size of its pictures in pixels")
        lens = np.array([[entry.width, 0, entry.width / 2], [0, entry.width, entry.height / 2], [0, 0, 1]], np.float64)
        cameras.append(Camera(entry.name, lens, np.eye(4), entry.width, entry.height, np.zeros(5)))
    addresses = _addresses(path, file)
    sound = _sound(path, file, addresses)
    return RigDefinition(
        *(path, tuple(cameras), addresses, file.fps, 1, UNCHANGED, file.realtime), sound=sound, offsets_ns=_stated(file)
    )


def _read(source: Path | dict[str, Any]) -> tuple[Path, _File]:
    """A name for the file, and its fields; no two of its cameras have one name."""
    path = source if isinstance(source, Path) else Path("rig definition")
    text = read_bytes(source, _MAX_BYTES) if isinstance(source, Path) else json.dumps(source).encode()
    try:
        file = _File.model_validate_json(text.removeprefix(BOM_UTF8))
    except ValidationError as error:
        place, fault = first_fault(error.errors())
        raise InputError(path, f"{place}: {fault}" if place else fault) from error
    names = [entry.name for entry in file.cameras]
    if len(set(names)) < len(names):
        double = next(name for name in names if names.count(name) > 1)
        raise InputError(path, f"describes two cameras called {double}; give each a name of its own")
    return path, file


def _stated(file: _File) -> dict[str, int]:
    return {entry.name: round(1_000_000 * entry.offset_ms) for entry in file.cameras if entry.offset_ms}


def _offsets(walk: RawRecording) -> dict[str, int]:
    """Offsets of the cameras that a walk recorded on one clock has shown; none if files began apart."""
    if not isinstance(walk.source, Videos) or not walk.source.one_clock:
        return {}
    names = (camera.name for camera in walk.cameras)
    offsets = {name: offset for name, offset in zip(names, walk.source.offsets_ns, strict=True) if offset}
    for name, offset in offsets.items():
        _LOG.info("camera %s: its pictures count %+.0f ms, as its walk has shown", name, offset / 1e6)
    return offsets


def _addresses(path: Path, file: _File) -> tuple[Address, ...]:
    found = tuple(parse_address(_beside(path, entry.source)) for entry in file.cameras)
    for entry, address in zip(file.cameras, found, strict=True):
        if address.scheme == "alsa":
            raise InputError(path, f"camera {entry.name} is a microphone; name it in the field sound")
    return found


def _sound(path: Path, file: _File, addresses: tuple[Address, ...]) -> SoundSource | None:
    if file.sound is None:
        return None
    cameras = {entry.name: address for entry, address in zip(file.cameras, addresses, strict=True)}
    found = choose_sound(path, file.sound, cameras, _beside(path, file.sound))
    if not file.realtime and found.address is not None and found.address.is_live:
        raise InputError(path, "realtime can be false only where the sound is of a file, too")
    return found


def _beside(path: Path, source: str) -> str:
    is_url = "://" in source or source.startswith(PUSH) or source.lower().startswith("file:/")
    return str(path.parent / source) if source and not is_url else source


def _camera(path: Path, entry: _CameraEntry) -> Camera:
    if entry.width is None or entry.height is None or entry.intrinsics is None or entry.world_to_camera is None:
        fault = "needs width, height, intrinsics and world_to_camera, or the file a calibration folder"
        raise InputError(path, f"camera {entry.name} {fault}")
    return Camera(
        entry.name,
        np.array(entry.intrinsics, np.float64),
        np.array(entry.world_to_camera, np.float64),
        entry.width,
        entry.height,
        np.array(entry.distortion or np.zeros(5), np.float64),
    )


def _known(path: Path, entry: _CameraEntry, known: dict[str, Camera]) -> Camera:
    if (entry.intrinsics, entry.distortion, entry.world_to_camera) != (None, None, None):
        raise InputError(path, f"camera {entry.name} is described here and in the calibration; leave one out")
    if entry.name not in known:
        raise InputError(path, f"camera {entry.name} is not in the calibration folder, which has {', '.join(known)}")
    found = known[entry.name]
    stated = (entry.width or found.width, entry.height or found.height)
    if stated != (found.width, found.height):
        fault = f"gives {stated[0]}x{stated[1]}, but is calibrated for {found.width}x{found.height}"
        raise InputError(path, f"camera {entry.name} {fault}; calibrate it anew, or correct its size")
    return found
