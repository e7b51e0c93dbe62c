"""Scatter plots as SVG, drawn by hand: points, names, and the front as a line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_WIDTH, _HEIGHT = 640, 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 24, 36, 52
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


def scatter(title: str, x: Axis, y: Axis, dots: Sequence[Dot]) -> str:
    """An SVG document.

    Raises:
        ValueError: no points, a number that is not finite, or one that a logarithm cannot show.
    """
    if not dots or not all(math.isfinite(value) for dot in dots for value in (dot.x, dot.y)):
        raise ValueError("a plot needs points, all of finite numbers")
    horizontal = _Scale([dot.x for dot in dots], x.logarithmic, _LEFT, _WIDTH - _RIGHT)
    vertical = _Scale([dot.y for dot in dots], y.logarithmic, _HEIGHT - _BOTTOM, _TOP)
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
    front = sorted((horizontal.place(dot.x), vertical.place(dot.y)) for dot in dots if dot.on_front)
    if len(front) > 1:
        places = " ".join(f"{at_x:.1f},{at_y:.1f}" for at_x, at_y in front)
        parts.append(f'<polyline points="{places}" fill="none" stroke="{_FRONT}" stroke-dasharray="4 3"/>')
    for dot in dots:
        at_x, at_y = horizontal.place(dot.x), vertical.place(dot.y)
        colour = _FRONT if dot.on_front else _OTHER
        parts.append(f'<circle cx="{at_x:.1f}" cy="{at_y:.1f}" r="4" fill="{colour}"/>')
        left = at_x > _WIDTH * 0.75
        anchor = 'text-anchor="end"' if left else ""
        parts.append(_text(at_x + (-7 if left else 7), at_y - 5, dot.name, f'{anchor} fill="{colour}"'))
    return "\n".join([*parts, "</svg>", ""])


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
        """Five values, evenly spread over the axis."""
        places = [self._low + (self._high - self._low) * (step + 0.5) / 5 for step in range(5)]
        return [10**place for place in places] if self._logarithmic else places

    def _unit(self, value: float) -> float:
        return math.log10(value) if self._logarithmic else value


def _text(x: float, y: float, text: str, attributes: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" {attributes}>{escape(text)}</text>'
