"""Recordings of calibrated cameras: one reader a layout behind one interface.

    n3dv         camNN.mp4 + poses_bounds.npy                 video_folder.py
    meetroom     cam_N.mp4 + poses_bounds.npy or sparse/0     video_folder.py
    colmap       sparse/0 + images, one instant or many       colmap/reader.py (colmap/model.py parses)
    transforms   transforms.json + pictures or videos         transforms.py
    caliscope    camera_array.toml + videos + timestamps      caliscope.py

A reader returns a `RawRecording`: cameras as calibrated, raw pictures. `open_dataset` makes a `Dataset` of it, which
selects cameras, undoes lens distortion and scales down.
"""

from streamlod.core.data.dataset import Dataset
from streamlod.core.data.open import LAYOUTS, open_dataset
from streamlod.core.data.prefetch import prefetch
from streamlod.core.data.splits import Split, linspace_split, read_split, training_cameras

__all__ = [
    "LAYOUTS",
    "Dataset",
    "Split",
    "linspace_split",
    "open_dataset",
    "prefetch",
    "read_split",
    "training_cameras",
]
