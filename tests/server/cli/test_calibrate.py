"""`streamlod calibrate` from videos of a rendered board walk, and what the data set then holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from streamlod.core.errors import InputError
from streamlod.server.cli.main import app
from tests.core.data.writers import write_video_clip


def test_the_board_is_printed_with_its_description(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["calibrate", "--print-board", str(tmp_path / "A4.pdf")])
    assert done.exit_code == 0, done.output
    assert "7x5 squares of 38 mm on A4" in done.output
    assert "square_size_override_cm = 3.8" in (tmp_path / "charuco.toml").read_text()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "needs DATA"),
        (["nowhere"], "nowhere: does not exist"),
        (["nowhere", "--board", "7by5"], "neither COLUMNSxROWS"),
        (["nowhere", "--board", "2x5"], "needs 3 to 40 squares"),
    ],
)
def test_unusable_arguments_are_refused(arguments: list[str], sentence: str) -> None:
    refused = CliRunner().invoke(app, ["calibrate", *arguments])
    assert isinstance(refused.exception, InputError)
    assert sentence in str(refused.exception)


@pytest.mark.parametrize("place", [".", "walk"])
def test_the_boards_description_is_found_with_the_videos_and_beside_their_folder(tmp_path: Path, place: str) -> None:
    """There it lies where it was printed and the walk recorded from one folder; without it, all lengths were wrong."""
    (tmp_path / "walk").mkdir()
    (tmp_path / place / "charuco.toml").write_text("columns = 0\nrows = 5\n")
    refused = CliRunner().invoke(app, ["calibrate", str(tmp_path / "walk")])
    assert "columns and rows must be whole numbers" in str(refused.exception)


def test_known_lenses_of_pictures_of_another_size_are_refused(tmp_path: Path) -> None:
    for folder, size in (("walk", (64, 48)), ("lenses", (96, 72))):
        write_video_clip(tmp_path / folder, ["cam00", "cam01"], 2, size)
    refused = CliRunner().invoke(app, ["calibrate", str(tmp_path / "walk"), "--lenses", str(tmp_path / "lenses")])
    assert isinstance(refused.exception, InputError)
    assert f"camera cam00: its lens in {tmp_path}/lenses is for 96x72, and the walk has 64x48" in str(refused.exception)
