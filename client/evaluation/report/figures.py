"""Plots as SVG documents, drawn by matplotlib: named points with their front, and named curves."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis as MatplotlibAxis

_SIZE = (8.0, 5.2)  # inches of 72 points
_FRONT, _OTHER = "#c2410c", "#64748b"
_NARROW, _WIDE = 5.0, 300.0  # ratios of the values on a logarithmic axis, between which 1, 2 and 5 suit as ticks
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "streamlod",  # identifiers are the same in every run
    "text.parse_math": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 9,
}


@dataclass(frozen=True, slots=True)
class Dot:
    """One point: its name, place, and whether it lies on the front."""

    name: str
    x: float
    y: float
    on_front: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """The quantity along an axis; a logarithmic one needs positive values."""

    label: str
    logarithmic: bool = False


@dataclass(frozen=True, slots=True)
class Curve:
    """Named (x, y) points that belong together."""

    name: str
    points: tuple[tuple[float, float], ...]


def scatter(title: str, x: Axis, y: Axis, dots: Sequence[Dot]) -> str:
    """An SVG document of named points; those on the front are joined by a line.

    Raises:
        ValueError: no points, a number that is not finite, or one that a logarithm cannot show.
    """
    _require_shown(x, y, [(dot.x, dot.y) for dot in dots])

    def draw(axes: Axes) -> None:
        front = sorted((dot.x, dot.y) for dot in dots if dot.on_front)
        if len(front) > 1:
            axes.plot(*zip(*front, strict=True), linestyle="--", linewidth=1, color=_FRONT, gid="front")
        for number, dot in enumerate(dots):
            colour = _FRONT if dot.on_front else _OTHER
            axes.plot(dot.x, dot.y, "o", color=colour, gid=f"dot-{number}")
            axes.annotate(dot.name, (dot.x, dot.y), (5, 4), textcoords="offset points", color=colour, fontsize=8)

    return _document(title, x, y, draw)


def curves(title: str, x: Axis, y: Axis, lines: Sequence[Curve]) -> str:
    """An SVG document of curves with a legend; ValueError as for `scatter`."""
    _require_shown(x, y, [point for line in lines for point in line.points])

    def draw(axes: Axes) -> None:
        for number, line in enumerate(lines):
            axes.plot(*zip(*line.points, strict=True), label=line.name, gid=f"curve-{number}")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)

    return _document(title, x, y, draw)


def _require_shown(x: Axis, y: Axis, points: Sequence[tuple[float, float]]) -> None:
    if not points or not all(math.isfinite(value) for point in points for value in point):
        raise ValueError("a plot needs points, all of finite numbers")
    for axis, values in zip((x, y), zip(*points, strict=True), strict=True):
        if axis.logarithmic and min(values) <= 0:
            raise ValueError("a logarithmic axis shows positive numbers only")


def _document(title: str, x: Axis, y: Axis, draw: Callable[[Axes], None]) -> str:
    """An SVG document with what `draw` puts between axes `x` and `y`."""
    from matplotlib import rc_context  # half a second that only reports need
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(_SIZE, layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot(title=title, xlabel=x.label, ylabel=y.label)
        draw(axes)
        axes.set(xscale="log" if x.logarithmic else "linear", yscale="log" if y.logarithmic else "linear")
        for side, axis in ((axes.xaxis, x), (axes.yaxis, y)):
            if axis.logarithmic:
                _space_ticks(side)
            side.set_major_formatter("{x:.4g}")
        axes.margins(0.08)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def _space_ticks(side: MatplotlibAxis) -> None:
    """Ticks at 1, 2 and 5 times each power of ten; the powers or round values where these do not suit."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    low, high = side.get_data_interval()
    if high <= _NARROW * low:
        side.set_major_locator(MaxNLocator(6))
    elif high <= _WIDE * low:
        side.set_major_locator(LogLocator(subs=(1, 2, 5)))
    side.set_minor_formatter(NullFormatter())
