"""Points from depth that VGGT (Wang et al. 2025) predicts, an optional package.

VGGT cannot be told poses: it predicts its own, in its own scale.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.core.errors import BackendUnavailable, InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.method import PointSources
from streamlod.core.initialise.predicted_depth import PredictedDepth, predicted_points
from streamlod.core.initialise.views import WorkingViews

WEIGHTS_VARIABLE = "STREAMLOD_VGGT"
_SIDE = 518  # pixels of the longer side of a picture, as in the model's training


def vggt_points(sources: PointSources) -> PointCloud:
    """Points on which depth maps by the weights that STREAMLOD_VGGT names agree, placed into the known cameras.

    Raises:
        InputError: fewer than two views, cameras that all stand at one place, or weights that cannot be read.
        BackendUnavailable: the package or the weights are missing.
    """
    return predicted_points(sources.views(_SIDE), _SIDE, _predict)


METHOD = vggt_points


def _predict(views: WorkingViews) -> PredictedDepth:
    """The prediction of the model for views at its size."""
    try:
        import torch
        from vggt.models.vggt import VGGT
        from vggt.utils.pose_enc import pose_encoding_to_extri_intri
    except ImportError as error:
        raise BackendUnavailable("the package vggt", "install it from its repository, or use sweep") from error
    weights = os.environ.get(WEIGHTS_VARIABLE)
    if not weights or not Path(weights).is_file():
        raise BackendUnavailable("the VGGT weights", f"set {WEIGHTS_VARIABLE} to the file model.pt, or use sweep")
    model: Any = VGGT()
    try:
        model.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    except Exception as error:  # what torch raises for damaged files has no common base
        raise InputError(weights, "does not hold the weights of VGGT-1B") from error
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model = model.to(device).eval()
    pictures = torch.from_numpy(views.images).permute(0, 3, 1, 2).to(device)
    half = device == "cuda"
    kind = torch.bfloat16 if half and torch.cuda.get_device_capability()[0] >= 8 else torch.float16
    with torch.no_grad(), torch.autocast(device, kind, enabled=half):
        answer = model(pictures)
    poses, _ = pose_encoding_to_extri_intri(answer["pose_enc"].float(), tuple(pictures.shape[2:]))

    def array(values: Any) -> Any:
        return values.float().cpu().numpy()

    depth, confidence = array(answer["depth"])[0, ..., 0], array(answer["depth_conf"])[0]
    return PredictedDepth(depth, confidence, array(poses)[0].astype(np.float64))
