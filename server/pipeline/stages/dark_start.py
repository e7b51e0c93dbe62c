"""First frames of nearly nothing: a clip that fades in, a stage before its lights, a camera that has just woken.

What was trained of black pictures has no anchors left, and later frames, which change the anchors that are there, do
not bring them back: such a scene would stay black. It is trained anew as soon as there is something to train.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.frames import FrameSet
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene

_BLOCK = 8  # pixels a side, whose mean has little noise
_SOMETHING = 4.0  # grey levels of contrast, below which there is nothing to train
_TIMES = 4.0  # how much more contrast makes a beginning anew worth its time
_LIT = 16.0  # grey levels of contrast that no dark beginning has; scenes in their light have 20 to 60


def contrast(frame: FrameSet) -> float:
    """Contrast of a frame's pictures in grey levels, 0 without any: how much their parts of 8x8 pixels differ.

    It is a standard deviation over a picture's parts, and the mean over colours and the cameras that are there.
    """
    height, width = _parts(*frame.images.shape[1:3])
    return _spread(
        cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in frame.images[frame.present]
    )


def contrast_of_scene(scene: Scene, cameras: Sequence[Camera]) -> float:
    """Contrast of the pictures that `scene` shows to `cameras`, as `contrast` has it."""
    splatter, small = Splatter(), (camera.scaled(*_parts(camera.width, camera.height)) for camera in cameras)
    return _spread(splatter.picture(scene, camera) for camera in small)


def is_worth_anew(first: float, frame: FrameSet) -> bool:
    """Whether a scene whose first frame had the contrast `first` is to be trained anew on this one.

    What has some light by then is not dark any more, so that a scene that gets ever brighter is trained anew twice at
    most.
    """
    return first < _LIT and contrast(frame) >= max(_SOMETHING, _TIMES * first)


def _parts(*sides: int) -> tuple[int, int]:
    across, down = (max(side // _BLOCK, 1) for side in sides)
    return across, down


def _spread(pictures: Iterable[UInt8]) -> float:
    small = list(pictures)
    return float(np.std(small, axis=(1, 2)).mean()) if small else 0.0
