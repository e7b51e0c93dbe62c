"""Training and held-out cameras."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.data import linspace_split, read_split, training_cameras
from streamlod.core.errors import InputError

MEET_ROOM = [f"cam_{number}" for number in range(13)]


def test_linspace_over_the_cameras_that_are_not_held_out() -> None:
    split = linspace_split(MEET_ROOM[::-1], 3, ["cam_0"])
    # 12 remain, cam_1 to cam_12: rows 0, round(5.5) = 6 (half to even) and 11
    assert split.train == ("cam_1", "cam_7", "cam_12")
    assert split.test == ("cam_0",)
    assert split.name == "linspace 3 of 12 without cam_0"
    assert linspace_split(MEET_ROOM, 5).train == ("cam_0", "cam_3", "cam_6", "cam_9", "cam_12")
    assert linspace_split(MEET_ROOM, None, ["cam_4"]).train == (*MEET_ROOM[:4], *MEET_ROOM[5:])


@settings(deadline=None)
@given(count=st.integers(1, 40), data=st.data())
def test_every_number_of_views_gives_that_many_cameras(count: int, data: st.DataObject) -> None:
    names = [f"cam{number}" for number in range(count)]
    views = data.draw(st.integers(1, count))
    train = linspace_split(names, views).train
    assert len(set(train)) == views
    assert train[0] == names[0]
    assert views == 1 or train[-1] == names[-1]


def test_requests_that_cannot_be_met() -> None:
    with pytest.raises(InputError, match="there is no camera cam9; there are cam_0, cam_1, cam_2"):
        linspace_split(MEET_ROOM, 3, ["cam9"])
    for views in (0, 13):
        with pytest.raises(InputError, match=f"{views} training cameras asked for, of 12 that are not held out"):
            linspace_split(MEET_ROOM, views, ["cam_0"])
    with pytest.raises(InputError, match=r"--test: holds out cam_0, .* all cameras; leave some to train"):
        linspace_split(MEET_ROOM, None, MEET_ROOM)


def test_split_file(tmp_path: Path) -> None:
    path = tmp_path / "split.json"
    path.write_text(json.dumps({"train": ["cam_3", "cam_1"], "test": ["cam_0"]}))
    split = read_split(path, MEET_ROOM)
    assert (split.name, split.train, split.test) == ("split.json", ("cam_3", "cam_1"), ("cam_0",))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"train": ["cam_99"]}, "there is no camera cam_99; there are cam_0"),
        ({"train": ["cam_1"], "test": ["cam_1"]}, "cam_1 both train and test"),
        ({"train": ["cam_1", "cam_1"]}, "names a camera twice"),
        ({"train": []}, "must name at least one camera"),
        ({"train": "cam_1"}, "must be a list of camera names"),
        ({"train": [1]}, "must be a list of camera names"),
        ([], "must hold a JSON object"),
    ],
)
def test_faults_in_split_files(tmp_path: Path, value: object, message: str) -> None:
    path = tmp_path / "split.json"
    path.write_text(json.dumps(value))
    with pytest.raises(InputError, match=rf"split\.json: {message}|{message}"):
        read_split(path, MEET_ROOM)


def test_training_cameras_are_named_once_and_as_many_as_asked_for() -> None:
    names = ("cam00", "cam01", "cam02")
    assert training_cameras(names, ("cam02", "cam00"), 2, ()) == ("cam02", "cam00")
    with pytest.raises(InputError, match="--train: names a camera twice"):
        training_cameras(names, ("cam01", "cam01"), None, ())
    with pytest.raises(InputError, match="--views: asks for 3 training cameras, but --train names 1"):
        training_cameras(names, ("cam01",), 3, ())
