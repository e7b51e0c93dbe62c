"""What has kernels to compile: the one list that `streamlod warm` goes through.

A part with kernels has a function that calls each of them once; Numba keeps the results on disk. The imports are
inside the functions, as a server needs the codec alone and must not load what trains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from core.errors import StreamlodError


def warm_codec() -> None:
    """Encode and decode a tiny scene."""
    from codec.warm import warm_up

    warm_up()


def _rasteriser() -> None:
    from core.render.cpu import warm

    warm()


def _trainer() -> None:
    from core.train.kernels.warming import warm

    warm()


def _first_points() -> None:
    """Draw a tiny synthetic clip, and sweep planes through it."""
    from core.initialise import first_points
    from core.synthetic import SyntheticSpec, open_synthetic

    clip = open_synthetic(SyntheticSpec(cameras=3, frames=2, width=64, height=36))
    frame = list(clip.frames())[-1]
    with suppress(StreamlodError):  # pictures this small show too little to find many points
        first_points(frame, clip.cameras, depth_bounds=clip.depth_bounds, method="sweep")


WARM_UPS: Mapping[str, Callable[[], None]] = {
    "rasteriser": _rasteriser,
    "trainer": _trainer,
    "codec": warm_codec,
    "synthetic clip and first points": _first_points,
}
