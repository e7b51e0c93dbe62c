"""Flow of pictures, and of anchors."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import torch

from streamlod.core.camera import Camera
from streamlod.core.train.motion.optical_flow import AnchorFlow, anchor_flow, picture_flow
from tests.core.train.motion.moved import RIG, Moved, moved_state

LEAST = 0.5


def texture(height: int, width: int, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.5)) * 2 - 0.5


def test_a_picture_that_is_shifted_flows_by_the_shift() -> None:
    wide = texture(80, 140)
    before, now = wide[8:72, 8:128], wide[10:74, 3:123]  # what was at (x, y) is at (x + 5, y - 2)
    flow = picture_flow(before, now)
    assert flow.shape == (64, 120, 2)
    assert np.abs(np.median(flow[8:-8, 8:-8], axis=(0, 1)) - [5.0, -2.0]).max() < 0.1


def test_a_picture_that_is_too_small_for_the_method_flows_nowhere() -> None:
    assert not picture_flow(texture(8, 90), texture(8, 90, 1)).any()


def flow_of(moved: Moved, masks: torch.Tensor) -> AnchorFlow:
    rows = torch.arange(len(moved.motion))
    return anchor_flow(moved.state.field, rows, moved.state.known.filmed, moved.views, masks, LEAST)


def everywhere(moved: Moved) -> torch.Tensor:
    return torch.ones(moved.views.targets.shape[:3], dtype=torch.bool)


def test_most_anchors_flow_as_they_went() -> None:
    moved = moved_state()
    found = flow_of(moved, everywhere(moved))
    places = [moved.state.field.position, moved.state.field.position + moved.motion]
    for number, camera in enumerate(RIG):
        then, now = (camera_pixels(camera, place.double().numpy()) for place in places)
        chosen = (found.seen[number] > 0).numpy() & moved.moving.numpy()
        assert chosen.sum() > 30
        wrong = np.linalg.norm(found.flow[number].numpy() - (now - then), axis=1)[chosen]
        assert np.median(wrong) < 0.4 * np.median(np.linalg.norm(now - then, axis=1)[chosen])


def test_pixels_that_did_not_change_or_hardly_moved_are_not_asked() -> None:
    moved = moved_state()
    masks = everywhere(moved)
    masks[1] = False
    found = flow_of(moved, masks)
    assert not found.seen[1].any()
    assert not found.flow[1].any()
    assert found.seen[[0, 2, 3]].any(dim=1).all()
    assert not flow_of(moved_state((0.002, 0.0, 0.0)), masks).seen.any()


def test_what_lies_outside_a_picture_or_behind_a_camera_does_not_flow() -> None:
    moved = moved_state()
    field = moved.state.field
    behind = 2 * torch.from_numpy(RIG[0].centre).float() - field.position
    wild = replace(field, position=torch.where(moved.moving[:, None], behind, torch.tensor(1e30)))
    rows = torch.arange(len(moved.motion))
    found = anchor_flow(wild, rows, moved.state.known.filmed, moved.views, everywhere(moved), LEAST)
    assert not found.seen[0].any()
    assert not found.flow[0].any()


def camera_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """[N,2] where world points are seen."""
    inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = inside @ camera.intrinsics.T
    return np.asarray(pixels[:, :2] / pixels[:, 2:])
