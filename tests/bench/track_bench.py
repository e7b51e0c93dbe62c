"""Calibration of simulated board walks: corners with noise, clocks seconds apart, and rolling shutters.

    python -m tests.bench.track_bench [--cameras 4 --seconds 60 --fps 15 --noise 0.15 --readout-ms 0 --apart 0.5]

Distorted cameras on an arc three metres away see a board that somebody carries about; nothing is drawn, so that one
thing after another can be made hard. Every second camera takes 0.6 of the readout. Prints the worst camera's error
beside the worst that is stated, and how far readouts and offsets are off.
"""

from __future__ import annotations

import argparse

import numpy as np

from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.solve import calibrate
from tests.core.calibration.alignment import differences
from tests.core.calibration.walks import BOARD, rig, walked


def main() -> None:
    """Simulate, calibrate and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--fps", type=float, default=15.0)
    parser.add_argument("--noise", type=float, default=0.15, help="pixels across and down")
    parser.add_argument("--readout-ms", type=float, default=0.0)
    parser.add_argument("--apart", type=float, default=0.5, help="seconds between clocks at most")
    given = parser.parse_args()
    truth = rig(given.cameras)
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, given.cameras) * given.apart
    readouts = given.readout_ms / 1000 * np.where(np.arange(given.cameras) % 2, 0.6, 1.0)
    tracks = walked(truth, given.seconds, given.fps, given.noise, offsets, readouts=readouts)
    found = calibrate(tracks, BOARD)
    degrees, metres = differences(
        np.array([rigid.pose(camera.world_to_camera) for camera in found.cameras]), truth.poses
    )
    late = np.abs(found.offsets - (offsets - offsets[found.root])).max()
    read = np.abs(found.readouts - np.stack([np.zeros(given.cameras), readouts], axis=1)).max()
    stated = found.errors.max(axis=0)
    print(f"at most {degrees.max():.3f} degrees ({stated[0]:.3f} stated), {1000 * metres.max():.2f} mm", end=" ")
    print(f"({1000 * stated[1]:.2f} stated), offsets {1000 * late:.2f} ms, readouts {1000 * read:.1f} ms")


if __name__ == "__main__":
    main()
