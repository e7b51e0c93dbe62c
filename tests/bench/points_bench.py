"""First points on the synthetic clip, where depth is known: how many pixels are trusted, and how right they are.

    python -m tests.bench.points_bench [--views 5 --width 240 --exposure 0.0 --known-bounds]

Prints the share of pixels that pass the cross-view tests, the fraction of those within 1, 2 and 5 % of the true depth,
and the CPU time.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from core.data import linspace_split
from core.frames import FrameSet
from core.initialise.bounds import estimate_bounds
from core.initialise.consistency import trusted
from core.initialise.sweep import sweep_views
from core.initialise.views import working_views
from core.synthetic import SyntheticSpec, open_synthetic, render_frame


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--width", type=int, default=240, help="at most 426, so that pictures are used as they are")
    parser.add_argument("--exposure", type=float, default=0.0, help="spread of the cameras' exposures in stops")
    parser.add_argument("--known-bounds", action="store_true")
    options = parser.parse_args()
    spec = SyntheticSpec(
        frames=1, width=options.width, height=options.width * 9 // 16, exposure_spread=options.exposure
    )
    dataset = open_synthetic(spec)
    rows = [dataset.names.index(name) for name in linspace_split(dataset.names, options.views, ("cam00",)).train]
    whole = next(iter(dataset.frames()))
    frame = FrameSet(0, 0, whole.images[rows], whole.present[rows])
    views = working_views(frame, [dataset.cameras[row] for row in rows], spec.height)
    began = time.process_time()
    bounds = dataset.depth_bounds if options.known_bounds and dataset.depth_bounds else estimate_bounds(views)
    maps = sweep_views(views, bounds)
    seconds = time.process_time() - began
    errors = []
    for index, depth_map in enumerate(maps):
        good = trusted(depth_map.points(), index, maps).reshape(depth_map.depth.shape)
        errors.append(np.abs(depth_map.depth / render_frame(spec, 0, rows[index]).depth - 1)[good])
    error = np.concatenate(errors)
    share = len(error) / (len(maps) * spec.width * spec.height)
    within = "  ".join(f"{limit:.0%} {(error < limit).mean():.3f}" for limit in (0.01, 0.02, 0.05))
    print(f"{options.views} views, bounds {bounds[0]:.2f} to {bounds[1]:.2f}: trusted {share:.3f}, within {within}")
    print(f"{seconds:.1f} s CPU (the first run compiles)")


if __name__ == "__main__":
    main()
