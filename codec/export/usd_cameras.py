"""The rig's cameras in an OpenUSD file, so that other programs can stand where the scene was filmed."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from streamlod.core.camera import Camera

_FLIP = np.diag([1.0, -1, -1, 1])  # OpenCV's axes, right-down-forward, to right-up-back
_APERTURE_MM = 36.0  # of a full-frame camera; only what it is beside the focal length matters


def add_usd_cameras(path: Path, cameras: Sequence[Camera]) -> None:
    """Add `cameras`, placed in a scene, to a file whose axes are right-up-back; their display names are ours."""
    usd, geometry, gf = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "Gf"))
    stage = usd.Stage.Open(str(path))
    for number, camera in enumerate(cameras):
        added = geometry.Camera.Define(stage, f"/Cameras/camera_{number:03}")
        added.GetPrim().SetDisplayName(camera.name)
        place = _FLIP @ np.linalg.inv(camera.world_to_camera) @ _FLIP
        added.AddTransformOp().Set(gf.Matrix4d(place.T.tolist()))  # its vectors are rows
        (fx, _, cx), (_, fy, cy) = camera.intrinsics[:2].tolist()
        unit = _APERTURE_MM / camera.width
        added.CreateFocalLengthAttr(fx * unit)
        added.CreateHorizontalApertureAttr(_APERTURE_MM)
        added.CreateVerticalApertureAttr(camera.height * fx / fy * unit)
        added.CreateHorizontalApertureOffsetAttr((camera.width / 2 - cx) * unit)
        added.CreateVerticalApertureOffsetAttr((cy - camera.height / 2) * fx / fy * unit)
    stage.GetRootLayer().Save()
