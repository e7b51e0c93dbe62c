"""The box and the tiles round what changed."""

import numpy as np
import pytest
import torch

from streamlod.core.train.pictures.boxes import around, tiles_near


@pytest.mark.parametrize("room", [0, 2, 50])
def test_the_box_holds_the_pixels_and_room_within_the_picture(room: int) -> None:
    mask = torch.zeros(20, 30, dtype=torch.bool)
    mask[5, 7] = mask[12, 27] = True
    inside = torch.zeros_like(mask)
    inside[around(mask, room)] = True
    wanted = torch.zeros_like(mask)
    wanted[max(5 - room, 0) : 13 + room, max(7 - room, 0) : 28 + room] = True
    assert torch.equal(inside, wanted)


def test_tiles_near_a_pixel() -> None:
    mask = np.zeros((40, 70), np.bool_)
    assert tiles_near(mask, 8).shape == (3, 5)
    assert not tiles_near(mask, 8).any()
    mask[39, 16] = True  # in the last, cut row of tiles, at the left edge of the second column
    assert np.argwhere(tiles_near(mask, 0)).tolist() == [[2, 1]]
    assert np.argwhere(tiles_near(mask, 7)).tolist() == [[2, 0], [2, 1]]
    assert np.argwhere(tiles_near(mask, 8)).tolist() == [[1, 0], [1, 1], [2, 0], [2, 1]]
    assert tiles_near(np.ones((40, 70), np.bool_), 0).all()
