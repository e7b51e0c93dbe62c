"""What a stream is made from. Small and plain: it travels to the worker process and lies in the catalogue."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from core.errors import InputError

_ID = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """Exactly one of `data`, `play` and `synthetic` says where frames come from.

    Attributes:
        id: name in URLs: lower-case letters, digits, ``-`` and ``_``.
        data: folder of a data set to train on.
        play: a recorded `.slod` file to stream in real time.
        synthetic: fields of `core.data.synthetic.SyntheticSpec` for a clip made on the fly.
        loop: whether `play` begins again at its end.
        layout, train, test, views, frames, downscale, preset, device, seed, points, keyframe_interval: as in
            `server.pipeline.TrainJob`.

    Raises:
        InputError: a bad id, or no single source.
    """

    id: str = "main"
    data: Path | None = None
    play: Path | None = None
    synthetic: dict[str, Any] | None = None
    loop: bool = True
    layout: str | None = None
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    views: int | None = None
    frames: int | None = None
    downscale: float = 1.0
    preset: str = "live"
    device: str = "auto"
    seed: int = 0
    points: str = "auto"
    keyframe_interval: int = 300

    def __post_init__(self) -> None:
        if not _ID.fullmatch(self.id):
            raise InputError(f"stream {self.id!r:.80}", "an id is 1 to 64 lower-case letters, digits, - or _")
        if sum(source is not None for source in (self.data, self.play, self.synthetic)) != 1:
            raise InputError(f"stream {self.id}", "name one source: data, play or synthetic")

    def to_json(self) -> dict[str, Any]:
        """Plain values; `spec_from_json` goes back."""
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self).items()}


def spec_from_json(values: dict[str, Any]) -> StreamSpec:
    """The specification with these fields.

    Raises:
        InputError: an unknown field, or one that the constructor refuses.
    """
    known = {field.name for field in fields(StreamSpec)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise InputError(f"stream field {unknown[0]!r:.80}", "is not known")
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    for name in ("data", "play"):
        if values.get(name) is not None:
            values[name] = Path(values[name])
    return StreamSpec(**values)
