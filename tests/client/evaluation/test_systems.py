"""One configuration on one split: what is trained once, what is measured, and that it repeats."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.client.evaluation.measure.footage import Footage, open_footage
from streamlod.client.evaluation.measure.scores import draw
from streamlod.client.evaluation.rows import unquantised
from streamlod.client.evaluation.summary import run_figures, spread
from streamlod.client.evaluation.systems import FirstFrames, run_system, with_steps
from streamlod.core.data import linspace_split
from streamlod.core.errors import InputError
from streamlod.core.train import preset
from tests.client.evaluation.conftest import SPEC, shortened

ROOT = Path(__file__).parents[3]
CONFIG = shortened(preset("balanced"))


@pytest.fixture(scope="module")
def first_frames() -> FirstFrames:
    return FirstFrames("cpu")


@pytest.mark.long
def test_first_frames_are_shared_by_what_differs_later_only(footage: Footage, first_frames: FirstFrames) -> None:
    training, _ = next(footage.pairs())
    one, *_ = first_frames.get(footage, training, CONFIG)
    other, *_ = first_frames.get(footage, training, replace(CONFIG, predict=replace(CONFIG.predict, cue="everything")))
    assert one.scene.levels is other.scene.levels
    reseeded, *_ = first_frames.get(footage, training, replace(CONFIG, seed=1))
    assert reseeded.scene.levels is not one.scene.levels


def test_other_steps_show_the_same_picture_and_finer_changes(footage: Footage, first_frames: FirstFrames) -> None:
    training, _ = next(footage.pairs())
    scene = first_frames.get(footage, training, CONFIG)[0].scene
    finer = with_steps(scene, CONFIG.predict, unquantised(CONFIG).predict)
    camera = footage.testing.cameras[0]
    np.testing.assert_array_equal(draw(scene, camera), draw(finer, camera))
    coarse = scene.weights.feature_decoder
    np.testing.assert_allclose(finer.weights.feature_decoder * 16, coarse, atol=1e-5)  # float16 below its normal range
    np.testing.assert_array_equal(finer.header.position_steps * 16, scene.header.position_steps)
    same = with_steps(scene, CONFIG.predict, CONFIG.predict)
    np.testing.assert_array_equal(same.weights.feature_decoder, scene.weights.feature_decoder)


@pytest.mark.long
def test_a_run_measures_every_frame_and_level(footage: Footage, first_frames: FirstFrames) -> None:
    run = run_system(CONFIG, footage, first_frames, spec=SPEC)
    assert [frame.frame for frame in run.frames] == [0, 1, 2]
    assert all(0 < frame.size.total_bytes < run.frames[0].size.total_bytes for frame in run.frames[1:])
    assert [frame.motion is None for frame in run.frames] == [True, False, False]
    assert run.caps[-1].picture.psnr == run.frames[-1].picture.psnr  # no cap is the whole picture
    assert run.caps[0].picture.psnr != run.caps[-1].picture.psnr
    assert [cap.levels for cap in run.caps] == list(range(1, len(run.frames[0].size.level_bytes) + 1))
    assert run.truth.shape == run.drawn.shape == (SPEC.height, SPEC.width, 3)
    figures = run_figures(run)
    assert set(figures["places"]["at"]) == {camera.name for camera in footage.training.cameras}
    assert 10 < figures["at_psnr"] <= figures["at_psnr_fitted"]
    assert figures["beside_0.1_psnr"] > 10
    assert figures["lpips_alex"] is None
    assert figures["predicted_bytes_max"] >= figures["predicted_bytes_mean"]
    assert figures["predicted_bytes_mean"] < figures["stream_bytes"] < figures["keyframe_bytes"]
    assert figures["stream_kbps"] == pytest.approx(figures["stream_bytes"] * 8 * SPEC.fps / 1000)
    again = run_figures(run_system(CONFIG, footage, FirstFrames("cpu")))
    assert again["psnr"] == pytest.approx(figures["psnr"], abs=0.05)  # threads add in any order


@pytest.mark.long
def test_the_first_frame_is_shown_as_it_was_trained_whatever_the_cue(
    footage: Footage, first_frames: FirstFrames
) -> None:
    """Cues that see the static error would otherwise train the first frame twice."""
    pictures, two = [], replace(footage, frames=2)  # with one alone, nothing is predicted
    for predict in (
        CONFIG.predict,
        replace(CONFIG.predict, cue="canonical"),
        replace(CONFIG.predict, cue="everything"),
    ):
        run = run_system(replace(CONFIG, predict=predict), two, first_frames)
        pictures.append(run.frames[0].picture.psnr)
    assert pictures[0] == pictures[1] == pictures[2]


@pytest.mark.long
def test_anchors_move_as_far_in_finer_steps(footage: Footage, first_frames: FirstFrames) -> None:
    """Sixteen times as far, pictures would lose 0.4 dB."""
    predict = replace(CONFIG.predict, cue="everything", rate_weight=0.0, minimum_steps=40)
    config = replace(CONFIG, predict=predict)
    coarse, fine = (run_system(each, footage, first_frames) for each in (config, unquantised(config)))
    assert fine.frames[-1].picture.psnr > coarse.frames[-1].picture.psnr - 0.1
    assert run_figures(coarse)["dynamic_share"] == 1  # of those there were, whatever went in the frame


@pytest.mark.long
def test_no_later_frame_is_charged_with_what_is_loaded_or_compiled(clip: Path) -> None:
    command = [sys.executable, "-m", "tests.client.evaluation.charged", str(clip)]
    answer = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert json.loads(answer.stdout.splitlines()[-1]) == []


@pytest.mark.long
def test_frozen_costs_next_to_nothing_and_changes_nothing(footage: Footage, first_frames: FirstFrames) -> None:
    run = run_system(CONFIG, footage, first_frames, frozen=True, spec=SPEC)
    empty = 44 + 12 * len(run.frames[1].size.level_bytes)  # header and directory alone
    assert all(frame.size.total_bytes <= empty and frame.report.total_seconds == 0 for frame in run.frames[1:])
    motion = run.frames[1].motion
    assert motion is not None
    assert motion.dynamic == 0


def test_spread_over_seeds() -> None:
    runs = [dict.fromkeys(("psnr", "ssim"), value) for value in (1.0, 3.0)]
    summary = spread([{name: run.get(name) for name in _names()} for run in runs])
    assert summary["psnr"] == {"mean": 2.0, "spread": pytest.approx(2**0.5)}
    assert summary["lpips_vgg"] is None


def test_a_study_needs_a_held_out_camera(clip: object, footage: Footage) -> None:
    with pytest.raises(InputError, match="held-out"):
        open_footage(footage.training.recording.path, linspace_split(["cam00"], 1), frames=1, downscale=1)


def _names() -> tuple[str, ...]:
    from streamlod.client.evaluation.summary import FIGURES

    return FIGURES
