"""The zoo: scenes x views x seeds, ours against the paper's and plain Gaussians at equal CPU time.

    streamlod bench zoo --out ZOO [--data DATA] [--scenes bright castle] [--views 3 4 6 12] [--seeds 2]
        [--systems ours plain paper] [--preset balanced] [--downscale 2] [--frames 6]
        [--points sweep]

Goes on where it was stopped: cells that `ZOO/cells.jsonl` holds are not measured again. Recordings are looked for under
--data or STREAMLOD_DATA; those that are not there are skipped. ZOO/zoo.md is the report, ZOO/pictures hold truth, ours
and plain side by side.
"""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path

from tests.bench.zoo.run import ZooOptions, run_zoo


def main() -> None:
    default = ZooOptions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--data", type=Path, default=os.environ.get("STREAMLOD_DATA"), help="folder of recordings")
    parser.add_argument("--scenes", nargs="+", default=default.scenes)
    parser.add_argument("--views", nargs="+", type=int, default=default.views)
    parser.add_argument("--seeds", type=int, default=default.seeds)
    parser.add_argument("--systems", nargs="+", default=default.systems)
    parser.add_argument("--preset", default=default.preset)
    parser.add_argument("--downscale", type=float, default=default.downscale)
    parser.add_argument("--frames", type=int, default=default.frames)
    parser.add_argument("--points", default=default.points)
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    chosen = ZooOptions(
        tuple(options.scenes),
        tuple(options.views),
        options.seeds,
        tuple(options.systems),
        options.preset,
        options.downscale,
        options.frames,
        options.points,
    )
    print(run_zoo(options.data, options.out, chosen))


if __name__ == "__main__":
    main()
