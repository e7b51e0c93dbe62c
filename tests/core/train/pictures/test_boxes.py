"""The box round what changed."""

import pytest
import torch

from streamlod.core.train.pictures.boxes import around


@pytest.mark.parametrize("room", [0, 2, 50])
def test_the_box_holds_the_pixels_and_room_within_the_picture(room: int) -> None:
    mask = torch.zeros(20, 30, dtype=torch.bool)
    mask[5, 7] = mask[12, 27] = True
    inside = torch.zeros_like(mask)
    inside[around(mask, room)] = True
    wanted = torch.zeros_like(mask)
    wanted[max(5 - room, 0) : 13 + room, max(7 - room, 0) : 28 + room] = True
    assert torch.equal(inside, wanted)
