"""The scenes of the zoo. One half is for choosing defaults, the other only for reporting: keep to it.

A default changes only when the mean over the choosing half improves and no scene of it loses more than 0.3 dB. Nobody
tunes on the reporting half.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from streamlod.core.data import Dataset, open_dataset
from streamlod.core.synthetic import SyntheticSpec, open_synthetic

Half = Literal["choosing", "reporting"]
MAX_VIEWS = 12
_RIG, _WIDTH, _HEIGHT, _FRAMES = 13, 480, 270, 60


@dataclass(frozen=True, slots=True)
class ZooScene:
    """One scene.

    Attributes:
        name: in tables; of a recording, its folder under the data root as well.
        half: what it may be used for.
        held_out: the camera that measures.
        open: the data set, from the data root and how many times smaller its pictures are than nominal; None where
            the data root has no such recording.
        spec: of a synthetic scene, from how many times smaller; None for a recording.
    """

    name: str
    half: Half
    held_out: str
    open: Callable[[Path | None, float], Dataset | None]
    spec: Callable[[float], SyntheticSpec | None]


def _synthetic(kind: str, half: Half) -> ZooScene:
    def spec(downscale: float) -> SyntheticSpec:
        size = round(_WIDTH / downscale), round(_HEIGHT / downscale)
        return SyntheticSpec(kind=kind, cameras=_RIG, frames=_FRAMES, width=size[0], height=size[1])

    return ZooScene(kind, half, "cam00", lambda _, downscale: open_synthetic(spec(downscale)), spec)


def _recorded(name: str, half: Half, held_out: str, nominal: float) -> ZooScene:
    """A recording whose pictures are taken `nominal` times smaller, and from there as asked, but never enlarged."""

    def opened(root: Path | None, downscale: float) -> Dataset | None:
        folder = None if root is None else root / name
        return open_dataset(folder, downscale=max(nominal * downscale, 1.0)) if folder and folder.is_dir() else None

    return ZooScene(name, half, held_out, opened, lambda _: None)


SCENES = (
    _synthetic("room", "choosing"),
    _synthetic("bright", "choosing"),
    _synthetic("night", "choosing"),
    _recorded("castle", "choosing", "0005", 1.0),
    _recorded("flame_steak_frame0", "choosing", "cam00", 2.0),
    _synthetic("theatre", "reporting"),
    _synthetic("outdoor", "reporting"),
    _recorded("stage", "reporting", "cam00", 1.0),
    _recorded("fountain", "reporting", "0005", 1.0),
    _recorded("caliscope_4cam", "reporting", "cam_0", 2.0),
)


def view_counts(wanted: tuple[int, ...], names: tuple[str, ...]) -> tuple[int, ...]:
    """Numbers of training cameras of a rig of which one is held out: those wanted, none above what there is."""
    most = min(len(names) - 1, MAX_VIEWS)
    return tuple(dict.fromkeys(min(count, most) for count in wanted))
