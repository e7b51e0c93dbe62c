"""Plots are well-formed and place their points where the numbers say."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import pytest

from client.evaluation.report.svg import Axis, Curve, Dot, curves, scatter

NAMESPACE = "{http://www.w3.org/2000/svg}"


def circles(svg: str) -> list[tuple[float, float]]:
    found = ElementTree.fromstring(svg).iter(f"{NAMESPACE}circle")
    return [(float(dot.attrib["cx"]), float(dot.attrib["cy"])) for dot in found]


def test_more_is_right_and_up() -> None:
    dots = [Dot("cheap", 1, 20, True), Dot("middle", 2, 25), Dot("dear", 3, 30, True)]
    (x0, y0), (x1, y1), (x2, y2) = circles(scatter("a plot", Axis("s"), Axis("dB"), dots))
    assert x0 < x1 < x2
    assert y0 > y1 > y2
    assert math.isclose(x1 - x0, x2 - x1, abs_tol=0.2)


def test_a_logarithmic_axis_spaces_by_ratio() -> None:
    dots = [Dot("a", 1, 0), Dot("b", 10, 0), Dot("c", 100, 0)]
    (x0, _), (x1, _), (x2, _) = circles(scatter("a plot", Axis("bytes", logarithmic=True), Axis("dB"), dots))
    assert math.isclose(x1 - x0, x2 - x1, abs_tol=0.2)


@pytest.mark.parametrize(("low", "high"), [(0, 1), (24.26, 26.87), (-3, 1e6), (5, 5), (0.001, 0.0013)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    svg = scatter("", Axis(""), Axis(""), [Dot("", low, 0), Dot("", high, 1)])
    texts = [element for element in ElementTree.fromstring(svg).iter(f"{NAMESPACE}text") if element.text]
    ticks = [float(text.text or "") for text in texts if text.attrib.get("text-anchor") == "middle"]
    assert 2 <= len(ticks) <= 8
    assert all(len(f"{abs(tick):.10e}".split("e")[0].rstrip("0")) <= 6 for tick in ticks)
    assert all(0 <= float(text.attrib["x"]) <= 640 for text in texts)


def test_names_are_escaped_and_the_front_is_a_line() -> None:
    dots = [Dot("<script>&", 1, 1, True), Dot("b", 2, 2, True)]
    svg = scatter('"quoted" & <bold>', Axis("<x>"), Axis("&y"), dots)
    texts = [element.text for element in ElementTree.fromstring(svg).iter(f"{NAMESPACE}text")]
    assert "<script>&" in texts
    assert len(list(ElementTree.fromstring(svg).iter(f"{NAMESPACE}polyline"))) == 1


def test_curves_keep_their_order_and_are_named() -> None:
    svg = curves("a plot", Axis("frame"), Axis("dB"), [Curve("a", ((0, 1), (1, 3))), Curve("b&", ((0, 2), (1, 1)))])
    tree = ElementTree.fromstring(svg)
    lines = [line.attrib["points"].split() for line in tree.iter(f"{NAMESPACE}polyline")]
    heights = [[float(place.split(",")[1]) for place in line] for line in lines]
    assert heights[0][0] > heights[0][1]
    assert heights[1][0] < heights[1][1]
    assert {"a", "b&"} < {element.text for element in tree.iter(f"{NAMESPACE}text")}


def test_no_curves_are_refused() -> None:
    with pytest.raises(ValueError, match="points"):
        curves("a plot", Axis("x"), Axis("y"), [])


@pytest.mark.parametrize("dots", [[], [Dot("a", math.nan, 1)], [Dot("a", 1, math.inf)], [Dot("a", 0, 1)]])
def test_what_cannot_be_shown_is_refused(dots: list[Dot]) -> None:
    with pytest.raises(ValueError, match=r"points|positive"):
        scatter("a plot", Axis("x", logarithmic=True), Axis("y"), dots)
