"""Train a recording: python examples/train_recording.py CLIP scene.slod

CLIP is a folder of synchronised video of fixed cameras; `streamlod synth CLIP` makes one.
"""

from __future__ import annotations

import sys
from pathlib import Path

from streamlod import TrainJob, train_recording


def main(clip: str, out: str) -> None:
    job = TrainJob(data=Path(clip), test=("cam00",), preset="live", frames=3, downscale=2)
    figures = train_recording(job, Path(out), lambda frame: print(f"frame {frame.version}"))
    print(f"{figures.frames} frames, {figures.size_bytes / 1000:.0f} KB, {figures.seconds:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
