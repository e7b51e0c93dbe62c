"""How time grows, as a plot for people."""

from __future__ import annotations

import math
from typing import Any

from streamlod.client.evaluation.report.figures import Axis, Curve, curves


def growth_plot(title: str, unit: str, growth: dict[str, dict[str, Any]]) -> str:
    """An SVG document of the part ``growth`` of a benchmark: a curve for each thing that grows.

    Args:
        unit: of the times. growth: name -> {size: time, ..., "exponent": of the fitted power}; a size is a number or
            WIDTHxHEIGHT.
    """
    lines = []
    for name, times in growth.items():
        sizes = {math.prod(map(int, size.split("x"))): time for size, time in times.items() if size != "exponent"}
        least = min(sizes)
        points = tuple((size / least, time) for size, time in sorted(sizes.items()))
        lines.append(Curve(f"{name} ^{times['exponent']:.2f}", points))
    return curves(title, Axis("times the smallest size", logarithmic=True), Axis(unit, logarithmic=True), lines)
