"""Open a recording and look at its frames: python examples/open_recording.py scene.slod"""

from __future__ import annotations

import sys

from streamlod import open_recording


def main(path: str) -> None:
    recording = open_recording(path)
    print(f"versions {recording.versions[0]} to {recording.versions[-1]}")
    for frame in recording.frames():
        size = frame.key_bytes + frame.predicted_bytes
        print(f"{frame.time_ns / 1e9:.3f} s: {frame.scene.anchor_count} anchors, {size} bytes")
    last = recording.scene(recording.versions[-1])
    print("cameras:", ", ".join(camera.name for camera in last.header.cameras))


if __name__ == "__main__":
    main(*sys.argv[1:])
