"""The board: found in pictures, refused where it is another one, described in files, printed at true size."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.adjustment.projection import projected
from streamlod.core.calibration.adjustment.rigid import rotations
from streamlod.core.calibration.board.description import Board, board_text, read_board
from streamlod.core.calibration.board.detect import Detector
from streamlod.core.calibration.board.printing import fitted_to, print_board
from streamlod.core.calibration.board.seen import board_as_seen, track_of
from streamlod.core.errors import InputError
from tests.core.calibration.filmed import filmed, footage_of, rays_of

BOARD = Board()
LENS = np.array([500.0, 500, 319.5, 239.5, -0.15, 0.03, 0, 0, 0])
SIZE = 640, 480
POSE = np.array([0.3, -0.35, 0.1, -0.17, -0.12, 0.8])


@pytest.fixture(scope="module")
def picture() -> UInt8:
    return filmed(rays_of(LENS, SIZE), POSE, SIZE, BOARD)


def test_corners_are_found_to_a_tenth_of_a_pixel(picture: UInt8) -> None:
    found = Detector(BOARD)(picture)
    truth = projected(LENS, BOARD.corners @ rotations(POSE[:3])[0].T + POSE[3:])[0]
    assert found.count == BOARD.corner_count
    assert np.sqrt(((found.corners - truth) ** 2).sum(axis=1).mean()) < 0.1


def test_an_inverted_board_and_one_of_old_opencv_are_recognised() -> None:
    for board in (replace(BOARD, inverted=True), Board(6, 4, legacy=True)):
        shot = filmed(rays_of(LENS, SIZE), POSE, SIZE, board)
        described = replace(board, inverted=False, legacy=False)
        assert board_as_seen([footage_of("a", [shot])], described) == board


@pytest.mark.parametrize(
    ("described", "sentence"),
    [
        (Board(5, 7), r"board: has 7x5 squares, not 5x7; exchange columns and rows"),
        (Board(9, 7), r"board: its markers are seen \(0 to 16\), but do not lie as on a board of 9x7 squares"),
        (Board(7, 5, dictionary="DICT_6X6_50"), r"board: no board of 7x5 squares with markers of DICT_6X6_50"),
    ],
)
def test_another_board_is_refused(picture: UInt8, described: Board, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        board_as_seen([footage_of("a", [picture] * 2)], described)


def test_a_board_with_more_markers_is_refused(picture: UInt8) -> None:
    sentence = "board: camera a sees its marker 16, but a board of 4x3 squares has markers 0 to 5"
    with pytest.raises(InputError, match=sentence):
        track_of(footage_of("a", [picture] * 5), Board(4, 3))


def test_something_in_the_room_that_looks_like_a_marker_is_not_taken_for_another_board(picture: UInt8) -> None:
    """Bricks, toys and book spines do, in every picture."""
    marker = cv2.aruco.generateImageMarker(BOARD.opencv().getDictionary(), 37, 60)
    room = picture.copy()
    room[:100, 520:620] = 230
    room[20:80, 540:600] = marker[..., None]
    assert 37 in Detector(BOARD)(room).markers
    track = track_of(footage_of("a", [room] * 5), BOARD)
    assert (track.seen == Detector(BOARD)(picture).count).all()


@pytest.mark.parametrize("marker", [3, 16])
def test_something_in_the_room_that_is_read_as_a_marker_of_the_board_costs_no_corners(
    picture: UInt8, marker: int
) -> None:
    room = picture.copy()
    room[:100, 520:620] = 230
    room[20:80, 540:600] = cv2.aruco.generateImageMarker(BOARD.opencv().getDictionary(), marker, 60)[..., None]
    assert (np.array(Detector(BOARD)(room).markers) == marker).sum() == 2
    track = track_of(footage_of("a", [room] * 5), BOARD)
    np.testing.assert_allclose(track.corners[0], Detector(BOARD)(picture).corners, atol=0.05)


def test_a_camera_that_hardly_sees_the_board_is_not_said_to_see_another_one(picture: UInt8) -> None:
    empty = np.full_like(picture, 110)
    with pytest.raises(InputError, match="camera a: hardly sees the board; walk longer, facing it, nearer to it"):
        track_of(footage_of("a", [picture, picture, *[empty] * 6]), BOARD)


@pytest.mark.parametrize("metres", [1.6, 2.2])  # squares of 17 and 12 pixels
def test_corners_of_a_board_far_away_are_found_as_exactly(metres: float) -> None:
    pose = np.array([*POSE[:5], metres])
    found = Detector(BOARD)(filmed(rays_of(LENS, SIZE), pose, SIZE, BOARD))
    truth = projected(LENS, BOARD.corners @ rotations(pose[:3])[0].T + pose[3:])[0]
    assert found.count == BOARD.corner_count
    assert np.sqrt(((found.corners - truth) ** 2).sum(axis=1).mean()) < 0.2


def test_a_board_of_which_one_edge_is_seen_is_not_taken_for_another_one(picture: UInt8) -> None:
    corners = projected(LENS, BOARD.corners @ rotations(POSE[:3])[0].T + POSE[3:])[0]
    edge = picture.copy()
    edge[:, round(corners[:, 0].min()) + 20 :] = 110  # little more than the first column of squares is left
    with pytest.raises(InputError, match=r"camera a: at most 2 of the board's markers are read .*; hold it nearer"):
        track_of(footage_of("a", [edge] * 5), BOARD)


def test_a_board_with_too_few_corners_is_refused_before_it_is_printed() -> None:
    with pytest.raises(InputError, match="board: 3x3 squares have 4 inner corners, but 6 are needed; take 4x3 or more"):
        Board(3, 3)


def test_a_mirrored_board_is_named(picture: UInt8) -> None:
    mirrored = np.ascontiguousarray(picture[:, ::-1])
    with pytest.raises(InputError, match="camera front: its pictures show the board mirrored"):
        track_of(footage_of("front", [mirrored] * 2), BOARD)


def test_a_mirrored_board_is_named_though_some_of_its_pictures_are_misread(picture: UInt8) -> None:
    mirrored = np.ascontiguousarray(picture[:, ::-1])
    with pytest.raises(InputError, match="camera front: its pictures show the board mirrored"):
        track_of(footage_of("front", [*[mirrored] * 6, *[picture] * 2]), BOARD)


def test_two_boards_in_one_picture_are_refused(picture: UInt8) -> None:
    with pytest.raises(InputError, match="camera a: sees two boards at once in 5 of 5 pictures"):
        track_of(footage_of("a", [np.concatenate([picture, picture], axis=1)] * 5), BOARD)


def test_no_board_is_said_by_camera_and_for_all() -> None:
    empty = np.full((480, 640, 3), 110, np.uint8)
    with pytest.raises(InputError, match="camera a: hardly sees the board"):
        track_of(footage_of("a", [empty] * 4), BOARD)
    with pytest.raises(InputError, match="board: no board of 7x5 squares"):
        board_as_seen([footage_of("a", [empty]), footage_of("b", [empty])], BOARD)


def test_descriptions_are_written_and_read(tmp_path: Path) -> None:
    file = tmp_path / "charuco.toml"
    board = Board(9, 6, 0.0412, 0.7, "DICT_5X5_100", inverted=True, legacy=True)
    file.write_text(board_text(board))
    assert read_board(file) == board
    file.write_text(
        'columns = 4\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\nunits = "inch"\naruco_scale = 0.75\n'
    )
    assert read_board(file).square_m == pytest.approx(0.0254 * 8.5 / 4)


@pytest.mark.parametrize(
    "text",
    ["columns = 1e9\nrows = 5", "columns = 4.5\nrows = 5", "rows = 5", "columns = 4\nrows = 5\ndictionary = 'DICT_X'",
     "columns = 4\nrows = 5\nunits = 'foot'", "columns = [", "columns = 30\nrows = 30\nsquare_size_override_cm = 5"],
)  # fmt: skip
def test_descriptions_that_no_board_has_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "charuco.toml"
    file.write_text(text)
    with pytest.raises(InputError):
        read_board(file)


def test_the_print_has_its_true_size(tmp_path: Path) -> None:
    png, pdf = tmp_path / "board.png", tmp_path / "board.pdf"
    assert print_board(BOARD, png) == print_board(BOARD, pdf) == "A3"
    page = cv2.imread(str(png), cv2.IMREAD_GRAYSCALE)
    assert page.shape == (round(297 / 25.4 * 300), round(420 / 25.4 * 300))
    small = cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    corners = Detector(BOARD)(small).corners
    assert np.diff(corners[:6, 0]).mean() / 0.25 / 300 * 25.4 == pytest.approx(55, abs=0.1)  # millimetres
    box = re.search(rb"/MediaBox\s*\[\s*0 0 ([0-9.]+) ([0-9.]+)", pdf.read_bytes())
    assert box is not None
    assert [float(side) * 25.4 / 72 for side in box.groups()] == pytest.approx([420, 297], abs=0.01)
    assert fitted_to(BOARD, "A4").square_m == 0.038
    with pytest.raises(InputError, match="A0"):
        print_board(replace(BOARD, square_m=0.4), pdf)
