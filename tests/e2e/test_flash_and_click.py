"""Picture and sound of one instant, from the cameras' files through training to what is drawn and heard."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from streamlod import Splatter, camera_named, open_recording
from streamlod.codec.sound.beside import sound_beside
from streamlod.core.synthetic import SyntheticSpec, cameras
from streamlod.core.synthetic.render import render_image
from tests.clicks import heard_at, write_sounding
from tests.core.data.writers import llff_rows, write_video
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=4, frames=14, width=64, height=36, seed=2, fps=10)
FEW_STEPS = "keyframe.steps=100,keyframe.growth_interval=25,predict.minimum_steps=8"


@pytest.mark.long
def test_a_flash_is_drawn_when_its_click_is_heard(tmp_path: Path) -> None:
    """Within 40 ms, where the sound of the one camera that has some begins half a second after its pictures."""
    clip, out = tmp_path / "clip", tmp_path / "scene.slod"
    clip.mkdir()
    for number, camera in enumerate(cameras(SPEC)):
        room = [render_image(SPEC, index, number) // 2 for index in range(SPEC.frames)]
        flashing = [picture + 120 if index % 10 == 0 else picture for index, picture in enumerate(room)]
        if number == 1:
            write_sounding(clip / f"{camera.name}.mp4", 1.4, begin=0.5, pictures=flashing, fps=10)
        else:
            write_video(clip / f"{camera.name}.mp4", flashing, fps=10)
    np.save(clip / "poses_bounds.npy", llff_rows(cameras(SPEC)))
    points = true_points(SPEC)
    np.savez(tmp_path / "points.npz", positions=points.positions, colours=points.colours)

    command = [sys.executable, "-m", "streamlod.server.cli", "train", clip, "--out", out, "--test", "cam00"]
    command += ["--points", tmp_path / "points.npz", "--preset", "live", "--set", FEW_STEPS]
    subprocess.run(command, check=True, timeout=500)

    splatter, brightness = Splatter(), {}
    for frame in open_recording(out).frames():
        view = camera_named(frame.scene.header, "cam02")
        brightness[frame.time_ns / 1e9] = splatter.picture(frame.scene, view).mean()
    between = (min(brightness.values()) + max(brightness.values())) / 2
    flashed = [time for time, mean in brightness.items() if mean > between]
    assert flashed == [0.0, 1.0]
    assert heard_at(sound_beside(out)) == pytest.approx(flashed[1:], abs=0.04)
