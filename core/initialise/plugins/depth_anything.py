"""Points from depth that Depth Anything 3 (Lin et al. 2025, arXiv:2511.10647) predicts, an optional package.

It is told the poses of the cameras, and brings its depths to their scale itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera
from streamlod.core.errors import BackendUnavailable
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.predicted_depth import PredictedDepth, predicted_points
from streamlod.core.initialise.views import WorkingViews

_SIDE = 504  # pixels of the longer side of a picture, the package's default
_LINE = 1e-3  # cameras stand on one line if they leave it by less than this part of their extent


@dataclass(frozen=True, slots=True)
class DepthAnythingPoints:
    """Predicted depth, placed into the known cameras.

    Attributes:
        model: an any-view model, by its name at Hugging Face or by the folder that holds it. This one and the smaller
            ``depth-anything/DA3-SMALL`` are under Apache-2.0; larger ones are not for commercial use.
    """

    model: str = "depth-anything/DA3-BASE"

    def __call__(self, sources: PointSources) -> PointCloud:
        """Points on which the placed depth maps agree.

        Raises:
            InputError: fewer than two views, or cameras that all stand at one place.
            BackendUnavailable: the package or the weights are missing.
        """
        return predicted_points(sources.views(_SIDE), _SIDE, self._predict)

    def _predict(self, views: WorkingViews) -> PredictedDepth:
        """The prediction of the model for views at its size."""
        poses = poses_to_tell(views.cameras)
        intrinsics = np.stack([camera.intrinsics for camera in views.cameras])
        pictures = np.rint(views.images * 255).astype(np.uint8)
        with redirect_stdout(sys.stderr):  # the package prints what it does; standard output is for a command's result
            answer = self._loaded().inference(
                image=list(pictures),
                extrinsics=poses,
                intrinsics=None if poses is None else intrinsics,
                align_to_input_ext_scale=True,
                process_res=_SIDE,
            )
        return PredictedDepth(answer.depth, answer.conf, np.asarray(answer.extrinsics, np.float64))

    def _loaded(self) -> Any:
        """The model with its weights, which must be on this machine: nothing is downloaded."""
        try:
            import torch
            from depth_anything_3.api import DepthAnything3
        except ImportError as error:
            remedy = "install it from its repository ByteDance-Seed/Depth-Anything-3, or use sweep"
            raise BackendUnavailable("the package depth-anything-3", remedy) from error
        try:
            model: Any = DepthAnything3.from_pretrained(self.model, local_files_only=True)
        except Exception as error:  # what huggingface_hub raises has no common base
            remedy = f"fetch it with `hf download {self.model}`, or use sweep"
            raise BackendUnavailable(f"the model {self.model}", remedy) from error
        return model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


METHOD = DepthAnythingPoints()


def poses_to_tell(cameras: Sequence[Camera]) -> Float64 | None:
    """[V,4,4] world_to_camera in a unit of which the cameras are about one apart, None if the package cannot use them.

    The package divides poses by the median distance from the first camera, but never by less than 0.1, so that it would
    show cameras nearer than that to the model at a wrong scale. It aligns what the model predicts to these poses by a
    similarity of the camera centres (Umeyama 1991), and fails where this is not unique: for two cameras, and for
    cameras on one line. Without poses the model predicts its own, as VGGT does.
    """
    centres = np.stack([camera.centre for camera in cameras])
    centres -= centres.mean(axis=0)
    extent = np.linalg.svd(centres, compute_uv=False)
    if extent[1] <= _LINE * extent[0]:
        return None
    poses = np.stack([camera.world_to_camera for camera in cameras])
    poses[:, :3, 3] /= np.linalg.norm(centres, axis=1).mean()
    return poses
