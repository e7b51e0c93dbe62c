"""What a stream is made from, as REST bodies and the configuration file say it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from server.pipeline.spec import StreamSpec, spec_from_json


class NewStream(BaseModel):
    """A stream to create: exactly one of `data`, `live`, `play` and `synthetic`."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"id": "stage", "synthetic": {"cameras": 5, "frames": 30}, "start": True}]},
    )

    id: str = Field(pattern="^[a-z0-9][a-z0-9_-]{0,63}$")
    data: str | None = Field(default=None, max_length=4096, description="folder of a data set on the server")
    live: str | dict[str, Any] | None = Field(
        default=None, description="file of a live rig on the server, or the rig itself (docs/ingest.md)"
    )
    play: str | None = Field(default=None, max_length=4096, description="recorded .slod file on the server")
    synthetic: dict[str, int | float | str | bool | list[int]] | None = Field(
        default=None, description="clip made on the fly"
    )
    loop: bool = True
    train: list[str] = Field(default=[], max_length=256)
    test: list[str] = Field(default=[], max_length=256)
    views: int | None = Field(default=None, ge=1, le=256)
    frames: int | None = Field(default=None, ge=1, le=10_000_000)
    downscale: float = Field(default=1.0, ge=1.0, le=64.0)
    preset: str = Field(default="live", max_length=64)
    device: Literal["auto", "cpu", "cuda"] = "auto"
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    frame_budget_ms: float | None = Field(default=None, gt=0, le=1e6, description="time to train each later frame")
    target_kbps: float | None = Field(default=None, gt=0, le=1e7, description="rate of predicted packets")
    keyframe_interval: int = Field(default=100, ge=1, le=1_000_000, description="most frames between keyframes")
    start: bool = Field(default=False, description="start it at once")

    @property
    def spec(self) -> StreamSpec:
        """What the stream is made from; InputError if it cannot be made."""
        return spec_from_json(self.model_dump(exclude={"start"}, exclude_none=True))
