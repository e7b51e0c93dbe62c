"""Runs a system on the clip named, and prints what was loaded or compiled during its later frames; a process apart."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from streamlod.client.evaluation.measure.footage import open_footage
from streamlod.client.evaluation.systems import FirstFrames, run_system
from streamlod.core.data import linspace_split
from streamlod.core.train import preset
from tests.client.evaluation.conftest import SPEC, shortened
from tests.server.pipeline.warmed import kernels


def main(clip: Path) -> None:
    config, first_frames = shortened(preset("live")), FirstFrames("cpu")
    names = [f"cam{number:02d}" for number in range(SPEC.cameras)]
    footage = open_footage(clip, linspace_split(names, 2, names[:1]), frames=3, downscale=1)
    first_frames.get(footage, next(footage.pairs())[0], config)
    every = {name: kernel for name, kernel in kernels().items() if name.startswith("streamlod.core.train.")}
    before = {name: len(kernel.signatures) for name, kernel in every.items()}
    library = "sklearn.mixture" in sys.modules
    run_system(config, footage, first_frames)
    late = [name for name, kernel in every.items() if len(kernel.signatures) > before[name]]
    sys.stdout.write(json.dumps(late if library else [*late, "sklearn.mixture"]) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
