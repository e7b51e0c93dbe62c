"""Numeric order."""

from __future__ import annotations

from pathlib import Path

import pytest

from streamlod.core.data.names import (
    camera_names,
    counted,
    in_numeric_order,
    instant_numbers,
    like_most,
    listed,
    spoken,
)


def test_numbers_sort_as_numbers() -> None:
    assert in_numeric_order(["cam_10", "cam_2", "cam_1"]) == ["cam_1", "cam_2", "cam_10"]
    assert in_numeric_order(["cam11", "cam02", "cam00"]) == ["cam00", "cam02", "cam11"]
    assert in_numeric_order(["b", "2", "a1b2", "a1b10", "a", "a²"]) == ["2", "a", "a1b2", "a1b10", "a²", "b"]


def test_long_lists_are_cut() -> None:
    assert listed(["a", "b", "c"], at_most=2) == "a, b and 1 more"
    assert listed([]) == ""


def test_names_in_a_sentence_end_with_and() -> None:
    assert [spoken("abcd"[:count], at_most=3) for count in range(5)] == [
        "",
        "a",
        "a and b",
        "a, b and c",
        "a, b, c and 1 more",
    ]


def test_one_of_something_is_no_plural() -> None:
    assert [counted(number, "frame") for number in (0, 1, 2)] == ["0 frames", "1 frame", "2 frames"]


def test_names_fit_into_a_stream() -> None:
    assert camera_names(["cam00", "é" * 40]) == ["cam00", "é" * 32]
    assert camera_names(["a\udcfcb"]) == ["a\ufffdb"]
    long = [letter + "/" + "x" * 64 for letter in "ab"]
    assert camera_names(["cam00", *long]) == ["cam00", "1-" + "x" * 62, "2-" + "x" * 62]
    assert camera_names(["same", "same"]) == ["same", "same"]  # for the reader to refuse


def test_folders_like_most() -> None:
    def names(*folders: str) -> list[str]:
        return [folder.name for folder in like_most([Path(name) for name in folders])]

    assert names("0000", "0001", "thumbs") == ["0000", "0001"]
    assert names("frame_9", "frame_10", "frame_10_old") == ["frame_9", "frame_10"]
    assert names("begin", "end") == ["begin", "end"]
    assert names() == []


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["0000", "0001", "0003"], (0, 1, 3)),
        (["take2_10", "take2_20", "take2_40"], (0, 1, 3)),
        (["t7"], (0,)),
        (["frames"], (0,)),
        (["1700000000033", "1700000000066", "1700000000100"], (0, 1, 2)),  # milliseconds
        (["a1_b2", "a2_b1", "a2_b9"], (0, 1, 2)),
        (["1", "01", "2"], (0, 1, 2)),
        (["one", "two"], (0, 1)),
        (["1", "1b", "c"], (0, 1, 2)),
    ],
)
def test_instants_lie_where_their_numbers_say(names: list[str], numbers: tuple[int, ...]) -> None:
    assert instant_numbers(names) == numbers
