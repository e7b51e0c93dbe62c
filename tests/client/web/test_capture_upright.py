"""Phones that stand upright, or hang upside down, in front of a board: pictures fall where the calibration says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.board.detect import Detector
from streamlod.server.settings import Settings
from tests.client.web.conftest import CAMERA_FLAGS, TEST_FLAGS, chromium_path
from tests.client.web.phones import opened, says
from tests.client.web.test_board_walk import written
from tests.core.calibration.filmed import filmed, rays_of
from tests.core.calibration.walks import BOARD
from tests.server.ingest.push.stage import FPS, stage

pytestmark = pytest.mark.browser
SIZE = (360, 640)
LENS = np.array([420.0, 421.0, 183.0, 310.0, -0.12, 0.03, 0.0006, -0.0008, 0.0])


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
@pytest.mark.parametrize("turned", [0, 180], ids=["upright", "upside down"])
def test_pictures_of_upright_phones_fall_where_their_calibration_says(
    chromium: Any, tmp_path: Path, turned: int, codec: str
) -> None:
    """Of a phone upside down as the board's walk has shown it: the browser shows both in the same way."""
    about, beside = np.radians(turned), np.eye(4)
    beside[:3, 3] = np.array([0.04, -0.1, 1.0]) - BOARD.centre
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(about), -np.sin(about)], [np.sin(about), np.cos(about)]]
    pose = pose @ beside
    clip = written(tmp_path / "board.y4m", filmed(rays_of(LENS, SIZE), rigid.pose(pose), SIZE, BOARD))
    focal_x, focal_y, x, y, *distortion = LENS.tolist()
    camera = {
        "name": "phone1",
        "source": "push:",
        "width": SIZE[0],
        "height": SIZE[1],
        "intrinsics": [[focal_x, 0, x + 0.5], [0, focal_y, y + 0.5], [0, 0, 1]],
        "distortion": distortion,
        "world_to_camera": pose.tolist(),
    }
    flags = [*TEST_FLAGS, *CAMERA_FLAGS, f"--use-file-for-fake-video-capture={clip}"]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=flags)
    with (
        stage(Settings(), {"fps": FPS, "cameras": [camera]}) as found,
        opened(browser, found.page(f"&codec={codec}")) as page,
    ):
        says(page, "Ready to film")
        page.click("#film")
        image = found.wait(5)[-1].images[0]
        (placed,) = found.dataset.cameras
    browser.close()
    assert image.shape == (SIZE[1], SIZE[0], 3)
    seen = Detector(BOARD)(image)
    assert seen.count == len(BOARD.corners), "the board is whole, and is not mirrored"
    points = BOARD.corners @ placed.world_to_camera[:3, :3].T + placed.world_to_camera[:3, 3]
    pixels = (points @ placed.intrinsics.T)[:, :2] / points[:, 2:] - 0.5  # pixel centres at half-integers
    assert np.linalg.norm(seen.corners - pixels, axis=1).max() < 0.5
