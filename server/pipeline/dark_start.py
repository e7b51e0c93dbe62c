"""First frames of nearly nothing: a clip that fades in, a stage before its lights, a camera that has just woken.

What was trained of black pictures has no anchors left, and later frames, which change the anchors that are there, do
not bring them back: such a scene would stay black. It is trained anew as soon as there is something to train.
"""

from __future__ import annotations

import cv2
import numpy as np

from streamlod.core.frames import FrameSet

_BLOCK = 8  # pixels a side, whose mean has little noise
_SOMETHING = 4.0  # grey levels of contrast, below which there is nothing to train
_TIMES = 4.0  # how much more contrast makes a beginning anew worth its time


def contrast(frame: FrameSet) -> float:
    """Contrast of a frame's pictures in grey levels, 0 without any: how much their parts of 8x8 pixels differ.

    It is a standard deviation over a picture's parts, and the mean over colours and the cameras that are there.
    """
    height, width = (max(side // _BLOCK, 1) for side in frame.images.shape[1:3])
    small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in frame.images[frame.present]]
    return float(np.std(small, axis=(1, 2)).mean()) if small else 0.0


def is_worth_anew(first: float, now: float) -> bool:
    """Whether a scene whose first frame had the contrast `first` is to be trained anew on a frame that has `now`.

    Contrast is 127 grey levels at most, so that a scene that gets ever brighter is trained anew three times at most.
    """
    return now >= max(_SOMETHING, _TIMES * first)
