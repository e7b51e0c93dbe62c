"""Figures of a trained frame, as reports have them."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from streamlod.core.train import TrainedFrame
from streamlod.server.pipeline.stages.trace import Span


def spans_of(trained: TrainedFrame) -> tuple[Span, ...]:
    """When the parts of training ran."""
    return tuple(Span("train", *span) for span in trained.report.spans)


def report_of(trained: TrainedFrame, spans: tuple[Span, ...], version: int) -> dict[str, Any]:
    """Figures of `trained`, with the seconds of all stages in `spans`."""
    seconds: dict[str, float] = {}
    for span in spans:
        seconds[span.name] = seconds.get(span.name, 0.0) + span.end - span.begin
    figures = asdict(replace(trained.report, spans=()))
    del figures["spans"]
    return {**figures, "seconds": seconds, "total_seconds": sum(seconds.values()), "version": version}
