"""What has kernels to compile: the one list that `streamlod warm` goes through.

A part with kernels has a function that calls each of them once; Numba keeps the results on disk. The imports are
inside the functions, as a server needs the codec alone and must not load what trains.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from multiprocessing import get_context

import numpy as np

from streamlod.core.errors import StreamlodError


def warm_codec() -> None:
    """Encode and decode a tiny scene."""
    from streamlod.codec.warm import warm_up

    warm_up()


def _rasteriser() -> None:
    from streamlod.core.render.cpu import warm

    warm()


def _trainer() -> None:
    from streamlod.core.train.kernels.warming import warm

    warm()


def _first_points() -> None:
    """Draw a tiny synthetic clip, ask what moves in it, and sweep planes through it."""
    from streamlod.core.initialise import first_points
    from streamlod.core.synthetic import SyntheticSpec, is_dynamic, open_synthetic

    spec = SyntheticSpec(cameras=3, frames=2, width=64, height=36)
    clip = open_synthetic(spec)
    is_dynamic(spec, np.zeros((1, 3)), 1)
    frame = list(clip.frames())[-1]
    with suppress(StreamlodError):  # pictures this small show too little to find many points
        first_points(frame, clip.cameras, depth_bounds=clip.depth_bounds, method="sweep")


WARM_UPS: Mapping[str, Callable[[], None]] = {  # what takes longest comes first
    "synthetic clip and first points": _first_points,
    "codec": warm_codec,
    "rasteriser": _rasteriser,
    "trainer": _trainer,
}


def warm_all() -> Iterator[str]:
    """Go through all parts, each in a process of its own, one for each core; gives the name of each that is ready."""
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn"), max_tasks_per_child=1) as pool:
        parts = {pool.submit(warm_up): name for name, warm_up in WARM_UPS.items()}
        for part in as_completed(parts):
            part.result()
            yield parts[part]
