"""`.4dgs`, OpenUSD and glTF (KHR_gaussian_splatting) by the package `fourdgs`, the optional part `interchange`.

Each Gaussian is written for as long as its anchor stays as it is, so that what does not move is there once. Axes in
such a file are right-up-back; those of a scene are right-down-forward.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from streamlod.codec.export.bake import baked_rows
from streamlod.codec.export.ply import unit_quaternions
from streamlod.codec.export.upright import turned
from streamlod.core.arrays import Float32, Float64, Int64
from streamlod.core.errors import InputError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.gaussians import GaussianCloud, as_cloud, concatenate
from streamlod.core.scene.metadata import Metadata

MAX_BYTES = 1 << 30  # of a file that is read
_SYSTEM, _COLOURS = "y-up-right-handed", "srgb-rec709-display"  # of the files that are written
_CUTOFF = 0.05  # the format's own; nothing here fades
_EARLY = 1e-4  # seconds by which states begin before their time, which is rounded: who looks at 2/30 s sees the third
_AXES = np.array([1, -1, -1], np.float32)
_UP = {"y-up-right-handed": "y", "": "-y"}  # by the file's coordinate system; "" is one that says none
_Span = tuple[GaussianCloud, float, float]  # Gaussians, and the seconds from which to which they are shown


def library() -> ModuleType:
    """The package; InputError says how to get it."""
    try:
        return importlib.import_module("fourdgs")
    except ImportError as error:
        raise InputError(
            "--format", "such files need the package fourdgs: pip install 'streamlod[interchange]'"
        ) from error


def write_clip(
    path: Path, frames: Iterable[tuple[float, Scene]], viewpoints: Float64, facts: Metadata, fps: float
) -> int:
    """Write the states, each with the second at which it begins, as one file; the number of Gaussians written.

    Args:
        path: `.4dgs`, or `.usdc`, `.usda` for OpenUSD with time samples.
        viewpoints: [V,3] over which view-dependent colour is averaged.
        facts: title and unit are passed on. fps: time samples a second.

    Raises:
        InputError: no frame, no package, or numbers that the format cannot hold.
    """
    fourdgs, spans = library(), list(_spans(frames, viewpoints))
    if not spans:
        raise InputError(path, "there is nothing to write")
    clouds, begins, ends = zip(*spans, strict=True)
    cloud, sizes, end = concatenate(list(clouds)), [len(each) for each in clouds], ends[-1]
    gaussians = _set_of(cloud, np.repeat(begins, sizes), np.repeat(ends, sizes))
    try:
        if path.suffix == ".4dgs":
            about = {"coordinate_system": _SYSTEM, "color_space": _COLOURS, "title": facts.title or path.stem}
            options = fourdgs.WriteOptions(metadata=about, library="streamlod")
            fourdgs.write(str(path), gaussians, end, options=options)
        else:
            fourdgs.to_usd(
                str(path), gaussians, 0.0, cutoff=_CUTOFF, coordinate_system=_SYSTEM, color_space=_COLOURS,
                meters_per_unit=facts.metres_per_unit or 1.0, animated=True, fps=fps, duration_sec=end,
            )  # fmt: skip
    except (fourdgs.FourdgsError, ImportError) as error:
        raise InputError(path, str(error)) from error
    return len(cloud)


def encode_glb(cloud: GaussianCloud) -> bytes:
    """One instant as glTF with KHR_gaussian_splatting; ValueError for numbers that it cannot hold."""
    fourdgs, count = library(), len(cloud)
    gaussians = _set_of(cloud, np.zeros(count), np.full(count, np.inf))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.glb"
        try:
            fourdgs.to_gltf(
                str(path), gaussians, 0.0, cutoff=_CUTOFF, coordinate_system=_SYSTEM, color_space=_COLOURS
            )  # fmt: skip
        except fourdgs.FourdgsError as error:
            raise ValueError(str(error)) from error
        return path.read_bytes()


def decode_glb(path: Path) -> GaussianCloud:
    """The Gaussians of a glTF file; InputError where it cannot be read, is damaged or too large."""
    fourdgs = library()
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(path, f"is larger than {MAX_BYTES} bytes")
        every = fourdgs.from_gltf(str(path)).gaussians
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except (fourdgs.FourdgsError, ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(path, f"is no glTF file of Gaussians that can be read: {error}") from error
    return _cloud_of(every, every.positions, every.rotations, every.colors[:, 3], _AXES)


def _set_of(cloud: GaussianCloud, begins: Float64, ends: Float64) -> Any:
    """The package's own Gaussians, each shown from and to so many seconds."""
    count = len(cloud)
    wxyz = unit_quaternions(cloud.quaternions) * np.append(np.float32(1), _AXES)
    return library().GaussianSet(
        positions=cloud.means * _AXES,
        scales=cloud.scales,
        rotations=np.roll(wxyz, -1, axis=1),
        colors=np.concatenate([cloud.colours, cloud.opacities[:, None]], axis=1),
        motions=np.zeros((count, 3), np.float32),
        mu_t=np.zeros(count, np.float32),
        sigma_t=np.full(count, np.inf, np.float32),
        win_lo=begins,
        win_hi=ends,
    )


def _cloud_of(every: Any, means: Float32, rotations: Float32, opacities: Float32, axes: Float32) -> GaussianCloud:
    """The package's Gaussians, placed anew, as ours."""
    wxyz = np.roll(rotations, 1, axis=1) * np.append(np.float32(1), axes)
    colours = np.clip(every.colors[:, :3], 0, 1)
    return as_cloud(means * axes, wxyz, every.scales, np.clip(opacities, 0, 1), colours)


def _spans(frames: Iterable[tuple[float, Scene]], viewpoints: Float64) -> Iterator[_Span]:
    """Gaussians for as long as their anchors stay as they are."""
    before: Scene | None = None
    begins: list[Float64] = []
    at, last, step = 0.0, 0.0, 1.0
    for at, scene in frames:
        now, same = max(at - _EARLY, 0.0), False
        if before is not None:
            step, same = at - last, (before.keyframe, before.identifier) == (scene.keyframe, scene.identifier)
            for n, level in enumerate(before.levels):
                changed = _changed(before, scene, n) if same else np.flatnonzero(level.alive)
                yield from _shown(before, n, changed, begins[n], now, viewpoints)
                begins[n][changed] = now
        begins = [
            np.concatenate([begins[n] if same else np.zeros(0), np.full(len(level), now)])[: len(level)]
            for n, level in enumerate(scene.levels)
        ]
        before, last = scene, at
    if before is not None:
        for n, level in enumerate(before.levels):
            yield from _shown(before, n, np.flatnonzero(level.alive), begins[n], at + step, viewpoints)


def _changed(before: Scene, after: Scene, number: int) -> Int64:
    """Living rows of a level that are no longer what they were."""
    old, new = before.levels[number], after.levels[number]
    count = len(old)
    differs = (old.position != new.position[:count]).any(axis=1) | (old.latent != new.latent[:count]).any(axis=1)
    return np.flatnonzero(old.alive & (differs | ~new.alive[:count]))


def _shown(scene: Scene, number: int, rows: Int64, begins: Float64, end: float, viewpoints: Float64) -> Iterator[_Span]:
    for begin in np.unique(begins[rows]):
        cloud = baked_rows(scene, number, rows[begins[rows] == begin], viewpoints)
        if len(cloud) and end > begin:
            yield cloud, float(begin), end


def read_clip(path: Path, fps: float, up: str | None) -> Iterator[GaussianCloud]:
    """The clip's Gaussians `fps` times a second; all of them each time, those that are not shown with opacity 0.

    Args:
        up: the axis of the file that points up, whatever it says itself; None: as it says.

    Raises:
        InputError: the file cannot be read, is damaged, too large, or has axes that are not known here.
    """
    fourdgs = library()
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(path, f"is larger than {MAX_BYTES} bytes")
        clip = fourdgs.read(path.read_bytes(), recover_truncated=False)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except (fourdgs.FourdgsError, ValueError) as error:
        raise InputError(path, f"is no .4dgs file that can be read: {error}") from error
    system = clip.header.attributes.get("coordinate_system", "")
    up = up or _UP.get(system)
    if up is None:
        raise InputError(path, f"has the axes {system[:40]!r}, not known here; say with --up which of them points up")
    every = clip.gaussians
    for number in range(max(1, round(clip.duration_sec * fps))):
        state = clip.state_at(number / fps)
        means, rotations = every.positions.astype(np.float32), every.rotations.astype(np.float32)
        opacities, shown = np.zeros(len(means), np.float32), state["indices"]
        means[shown], rotations[shown] = state["centers"], state["orientations"]
        opacities[shown] = state["opacity"]
        yield turned(_cloud_of(every, means, rotations, opacities, np.ones(3, np.float32)), "-y", up)
