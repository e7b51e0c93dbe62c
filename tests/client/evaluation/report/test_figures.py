"""Plots are well-formed, the same in every run, and place their points where the numbers say."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import pytest

from streamlod.client.evaluation.report.figures import Axis, Curve, Dot, curves, scatter

NAMESPACE = "{http://www.w3.org/2000/svg}"


def group(svg: str, name: str) -> ElementTree.Element:
    groups = ElementTree.fromstring(svg).iter(f"{NAMESPACE}g")
    return next(element for element in groups if element.attrib.get("id") == name)


def dots_of(svg: str, count: int) -> list[tuple[float, float]]:
    places = [next(group(svg, f"dot-{number}").iter(f"{NAMESPACE}use")) for number in range(count)]
    return [(float(place.attrib["x"]), float(place.attrib["y"])) for place in places]


def texts(svg: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(svg).iter(f"{NAMESPACE}text")]


def test_more_is_right_and_up_and_the_front_is_a_line() -> None:
    dots = [Dot("cheap", 1, 20, True), Dot("middle", 2, 25), Dot("dear", 3, 30, True)]
    svg = scatter("a plot", Axis("s"), Axis("dB"), dots)
    (x0, y0), (x1, y1), (x2, y2) = dots_of(svg, 3)
    assert x0 < x1 < x2
    assert y0 > y1 > y2
    assert math.isclose(x1 - x0, x2 - x1, abs_tol=0.01)
    line = next(group(svg, "front").iter(f"{NAMESPACE}path")).attrib["d"].split()
    assert [float(number) for number in line if number not in "ML"] == pytest.approx([x0, y0, x2, y2], abs=0.01)


def test_a_logarithmic_axis_spaces_by_ratio() -> None:
    dots = [Dot("a", 1, 0), Dot("b", 10, 0), Dot("c", 100, 0)]
    (x0, _), (x1, _), (x2, _) = dots_of(scatter("a plot", Axis("bytes", logarithmic=True), Axis("dB"), dots), 3)
    assert math.isclose(x1 - x0, x2 - x1, abs_tol=0.01)


@pytest.mark.parametrize(
    ("low", "high", "logarithmic"),
    [(0.5, 1, False), (24.26, 26.87, False), (5, 5, False), (1, 1e6, True), (5, 5, True), (0.001, 0.0013, True)],
)
def test_axes_have_several_ticks(low: float, high: float, logarithmic: bool) -> None:
    svg = scatter("", Axis("", logarithmic), Axis(""), [Dot("", low, 0), Dot("", high, 1)])
    ticks = [element.attrib["id"] for element in group(svg, "matplotlib.axis_1") if "xtick" in element.attrib["id"]]
    labels = [text for tick in ticks for text in group(svg, tick).itertext() if text.strip()]
    assert 2 <= len(labels) <= 12
    assert all(float(label.replace("\N{MINUS SIGN}", "-")) >= 0 for label in labels)


def test_names_are_escaped_and_are_no_formulas() -> None:
    dots = [Dot("<script>&", 1, 1, True), Dot("$b^2$", 2, 2, True)]
    svg = scatter('"quoted" & <bold>', Axis("<x>"), Axis("&y"), dots)
    assert {"<script>&", "$b^2$", '"quoted" & <bold>', "<x>", "&y"} < set(texts(svg))


def test_a_plot_is_the_same_in_every_run() -> None:
    lines = [Curve("a", ((0, 1), (1, 3))), Curve("b&", ((0, 2), (1, 1)))]
    svg = curves("a plot", Axis("frame"), Axis("dB"), lines)
    assert svg == curves("a plot", Axis("frame"), Axis("dB"), lines)
    assert {"a", "b&"} < set(texts(svg))
    for number, rises in enumerate((True, False)):
        path = next(group(svg, f"curve-{number}").iter(f"{NAMESPACE}path")).attrib["d"].split()
        numbers = [float(part) for part in path if part not in "ML"]
        assert (numbers[3] < numbers[1]) == rises


def test_no_curves_are_refused() -> None:
    with pytest.raises(ValueError, match="points"):
        curves("a plot", Axis("x"), Axis("y"), [])


@pytest.mark.parametrize("dots", [[], [Dot("a", math.nan, 1)], [Dot("a", 1, math.inf)], [Dot("a", 0, 1)]])
def test_what_cannot_be_shown_is_refused(dots: list[Dot]) -> None:
    with pytest.raises(ValueError, match=r"points|positive"):
        scatter("a plot", Axis("x", logarithmic=True), Axis("y"), dots)
