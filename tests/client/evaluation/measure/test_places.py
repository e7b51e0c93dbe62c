"""Where viewers stand: which views are looked from, and what is measured there."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from streamlod.client.evaluation.measure.places import (
    BESIDE,
    mean_figure,
    mean_places,
    places,
    places_table,
    true_view,
)
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.synthetic import SyntheticSpec, cameras, render_image, render_view

SPEC = SyntheticSpec(cameras=4, frames=2, width=64, height=36, noise=0.0)


def test_a_view_of_the_rig_is_rendered_as_the_camera_films_it() -> None:
    np.testing.assert_array_equal(render_view(SPEC, 1, cameras(SPEC)[2]), render_image(SPEC, 1, 2))


def test_what_is_true_is_told_apart_from_what_is_too_bright() -> None:
    rig = cameras(SPEC)
    filmed = np.stack([render_image(SPEC, 0, number) for number in range(4)])

    def brighter(camera: Camera) -> UInt8:
        return np.asarray(render_view(SPEC, 0, camera) * 0.8, np.uint8)

    found = places(brighter, rig, filmed, SPEC)
    assert list(found["at"]) == [camera.name for camera in rig]
    assert list(found["beside"]) == [f"{share:g}" for share in BESIDE]
    for score in (*found["at"].values(), *found["beside"].values()):
        assert score["psnr"] < 30
        assert score["psnr_fitted"] > 45
    assert places(brighter, rig, filmed)["beside"] == {}
    assert mean_figure(found, "at", "psnr") == pytest.approx(np.mean([s["psnr"] for s in found["at"].values()]))
    assert mean_figure(found, "0.3", "psnr") is None
    assert "at cam01" in places_table(found)
    assert "10% of the way" in places_table(found)


def test_beside_the_cameras_of_smaller_pictures_the_truth_is_averaged_as_theirs_are() -> None:
    camera = cameras(SPEC)[1]
    small = camera.scaled(32, 18)
    averaged = cv2.resize(render_image(SPEC, 0, 1), (32, 18), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(true_view(SPEC, 0, small), averaged)
    assert np.abs(render_view(SPEC, 0, small).astype(int) - averaged).max() > 20
    turned = true_view(SPEC, 0, small.turned())
    assert np.abs(turned - np.rot90(averaged).astype(float)).mean() < 2  # edges are found along rows
    np.testing.assert_array_equal(true_view(SPEC, 0, camera), render_view(SPEC, 0, camera))


def test_frames_are_averaged_at_each_camera_that_has_them() -> None:
    def score(psnr: float) -> dict[str, float]:
        return {"psnr": psnr, "ssim": 0.5, "psnr_fitted": psnr}

    frames = [
        {"at": {"a": score(20.0)}, "beside": {"0.1": score(9.0)}},
        {"at": {"a": score(30.0), "b": score(7.0)}, "beside": {}},
    ]
    mean = mean_places(frames)
    assert (mean["at"]["a"]["psnr"], mean["at"]["b"]["psnr"]) == (25.0, 7.0)
    assert mean["beside"]["0.1"]["psnr"] == 9.0
    assert mean_places([]) == {"at": {}, "beside": {}}
