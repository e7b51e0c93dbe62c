"""Plots as SVG, drawn by hand: named points with their front, and named curves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_WIDTH, _HEIGHT = 640, 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 24, 36, 52
_LEGEND = 120  # width kept for the names of curves
_MOST_TICKS = 8
_FRONT, _OTHER, _INK = "#c2410c", "#64748b", "#1e293b"


@dataclass(frozen=True, slots=True)
class Dot:
    """One point: its name, place, and whether it lies on the front."""

    name: str
    x: float
    y: float
    on_front: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """What is measured along an axis; a logarithmic one needs positive values."""

    label: str
    logarithmic: bool = False


@dataclass(frozen=True, slots=True)
class Curve:
    """Named (x, y) points that belong together."""

    name: str
    points: tuple[tuple[float, float], ...]


def scatter(title: str, x: Axis, y: Axis, dots: Sequence[Dot]) -> str:
    """An SVG document of named points.

    Raises:
        ValueError: no points, a number that is not finite, or one that a logarithm cannot show.
    """
    horizontal, vertical = _scales(x, y, [(dot.x, dot.y) for dot in dots])
    parts = _frame(title, x, y, horizontal, vertical)
    front = sorted((horizontal.place(dot.x), vertical.place(dot.y)) for dot in dots if dot.on_front)
    if len(front) > 1:
        parts.append(_line(front, f'stroke="{_FRONT}" stroke-dasharray="4 3"'))
    for dot in dots:
        at_x, at_y = horizontal.place(dot.x), vertical.place(dot.y)
        colour = _FRONT if dot.on_front else _OTHER
        parts.append(f'<circle cx="{at_x:.1f}" cy="{at_y:.1f}" r="4" fill="{colour}"/>')
        left = at_x > _WIDTH * 0.75
        anchor = 'text-anchor="end" ' if left else ""
        parts.append(_text(at_x + (-7 if left else 7), at_y - 5, dot.name, f'{anchor}fill="{colour}"'))
    return "\n".join([*parts, "</svg>", ""])


def curves(title: str, x: Axis, y: Axis, lines: Sequence[Curve]) -> str:
    """An SVG document of curves with a legend; ValueError as for `scatter`."""
    horizontal, vertical = _scales(x, y, [point for line in lines for point in line.points], _LEGEND)
    parts = _frame(title, x, y, horizontal, vertical)
    for number, line in enumerate(lines):
        colour = f"hsl({360 * number // len(lines)} 65% 40%)"
        places = [(horizontal.place(at), vertical.place(value)) for at, value in line.points]
        parts.append(_line(places, f'stroke="{colour}"'))
        parts.append(_text(_WIDTH - _RIGHT - _LEGEND + 8, _TOP + 14 * (number + 1), line.name, f'fill="{colour}"'))
    return "\n".join([*parts, "</svg>", ""])


def _scales(x: Axis, y: Axis, points: Sequence[tuple[float, float]], legend: int = 0) -> tuple[_Scale, _Scale]:
    if not points or not all(math.isfinite(value) for point in points for value in point):
        raise ValueError("a plot needs points, all of finite numbers")
    horizontal = _Scale([point[0] for point in points], x.logarithmic, _LEFT, _WIDTH - _RIGHT - legend)
    return horizontal, _Scale([point[1] for point in points], y.logarithmic, _HEIGHT - _BOTTOM, _TOP)


def _frame(title: str, x: Axis, y: Axis, horizontal: _Scale, vertical: _Scale) -> list[str]:
    """The opening tag, axes, ticks and labels."""
    bottom = _HEIGHT - _BOTTOM
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        f'font-size="11" fill="{_INK}">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        _text(_WIDTH / 2, 20, title, 'text-anchor="middle" font-size="14"'),
        _text(_WIDTH / 2, _HEIGHT - 12, x.label, 'text-anchor="middle"'),
        _text(16, _HEIGHT / 2, y.label, f'text-anchor="middle" transform="rotate(-90 16 {_HEIGHT / 2})"'),
        f'<path d="M{_LEFT} {_TOP}V{bottom}H{_WIDTH - _RIGHT}" fill="none" stroke="{_INK}"/>',
    ]
    for tick in horizontal.ticks():
        at = horizontal.place(tick)
        parts.append(f'<path d="M{at:.1f} {bottom}v4" stroke="{_INK}"/>')
        parts.append(_text(at, bottom + 16, f"{tick:.4g}", 'text-anchor="middle"'))
    for tick in vertical.ticks():
        at = vertical.place(tick)
        parts.append(f'<path d="M{_LEFT} {at:.1f}h-4" stroke="{_INK}"/>')
        parts.append(_text(_LEFT - 7, at + 4, f"{tick:.4g}", 'text-anchor="end"'))
    return parts


def _line(places: Sequence[tuple[float, float]], attributes: str) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    return f'<polyline points="{points}" fill="none" {attributes}/>'


class _Scale:
    """From values to places between `begin` and `end`, with a margin."""

    def __init__(self, values: Sequence[float], logarithmic: bool, begin: float, end: float) -> None:
        if logarithmic and min(values) <= 0:
            raise ValueError("a logarithmic axis shows positive numbers only")
        self._logarithmic = logarithmic
        low, high = self._unit(min(values)), self._unit(max(values))
        margin = 0.06 * (high - low) or 0.5
        self._low, self._high, self._begin, self._end = low - margin, high + margin, begin, end

    def place(self, value: float) -> float:
        share = (self._unit(value) - self._low) / (self._high - self._low)
        return self._begin + share * (self._end - self._begin)

    def ticks(self) -> list[float]:
        """Round values inside the axis: about five, or on a logarithmic one 1, 2 and 5 of each decade, or decades."""
        if not self._logarithmic:
            return _round_values(self._low, self._high)
        decades = range(math.floor(self._low), math.ceil(self._high) + 1)
        for factors in ((1, 2, 5), (1,)):
            values = [factor * 10.0**decade for decade in decades for factor in factors]
            inside = [value for value in values if self._low <= math.log10(value) <= self._high]
            if len(inside) <= _MOST_TICKS:
                break
        return inside if len(inside) > 1 else [10**place for place in _evenly(self._low, self._high)]

    def _unit(self, value: float) -> float:
        return math.log10(value) if self._logarithmic else value


def _round_values(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten between `low` and `high`, at most six."""
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    return [number * step for number in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _evenly(low: float, high: float) -> list[float]:
    return [low + (high - low) * (step + 0.5) / 4 for step in range(4)]


def _text(x: float, y: float, text: str, attributes: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" {attributes}>{escape(text)}</text>'
