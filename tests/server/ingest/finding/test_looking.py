"""Looking through cameras: a picture of each or the reason, the sheet of all, and webcams as Linux lists them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from streamlod.server.ingest.cameras.address import parse_address
from streamlod.server.ingest.finding.looking import look_through
from streamlod.server.ingest.finding.sheet import contact_sheet
from streamlod.server.ingest.finding.webcams import Webcam, find_webcams
from tests.core.data.writers import put_display_matrix, write_video


def test_each_source_gives_a_picture_upright_or_a_reason(tmp_path: Path) -> None:
    grey = [np.full((64, 96, 3), 20 * number, np.uint8) for number in range(8)]
    write_video(tmp_path / "a.mp4", grey)
    write_video(tmp_path / "turned.mp4", grey)
    put_display_matrix(tmp_path / "turned.mp4", 0, 1, -1, 0)
    (tmp_path / "text.mp4").write_text("no video")
    names = [str(tmp_path / "a.mp4"), str(tmp_path / "turned.mp4"), str(tmp_path / "text.mp4"), "rtsp://127.0.0.1:1/a"]
    a, turned, text, nobody = look_through([parse_address(name) for name in names], 30, None)
    assert a.picture is not None
    assert a.picture.shape == (64, 96, 3)
    assert abs(a.picture.mean() - 100) < 4  # not the first: webcams find their exposure in a few pictures
    assert turned.picture is not None
    assert turned.picture.shape == (96, 64, 3)
    assert text.picture is None
    assert text.fault
    assert nobody.picture is None
    assert nobody.fault


def test_the_sheet_shows_every_camera_in_its_place() -> None:
    colours = {"red": (200, 0, 0), "green": (0, 200, 0), "none": None, "blue": (0, 0, 200), "more": (90, 90, 90)}
    sizes = [(72, 128), (128, 72), (1, 1), (3, 3), (1000, 20)]
    pictures = {
        name: None if colour is None else np.full((*size, 3), colour, np.uint8)
        for (name, colour), size in zip(colours.items(), sizes, strict=True)
    }
    sheet = cv2.imdecode(np.frombuffer(contact_sheet(pictures, {"none": "no answer"}), np.uint8), cv2.IMREAD_COLOR)
    assert sheet is not None
    assert sheet.shape == (2 * 388, 3 * 480, 3)
    for number, colour in enumerate(colours.values()):
        row, column = divmod(number, 3)
        middle = sheet[row * 388 + 170, column * 480 + 240, ::-1]
        if colour is not None:
            assert np.abs(middle.astype(int) - colour).max() < 12


def test_webcams_are_listed_by_number_without_their_further_devices(tmp_path: Path) -> None:
    for number, index, name in ((10, "0", "Desk\n"), (2, "0", "Lid"), (3, "1", "Lid: metadata")):
        folder = tmp_path / f"video{number}"
        folder.mkdir()
        (folder / "index").write_text(index)
        (folder / "name").write_text(name)
    (tmp_path / "video-x").mkdir()
    assert find_webcams(tmp_path) == (Webcam(2, "Lid"), Webcam(10, "Desk"))
    assert find_webcams(tmp_path)[1].source == "v4l2:///dev/video10"
    assert find_webcams(tmp_path / "missing") == ()
