"""Gaussians that other programs wrote, imported, play on the page as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from streamlod.client.recording import decode_frames
from streamlod.codec.imported import import_files
from streamlod.core.camera import pinhole
from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import comes_to_show, reference, shows

pytestmark = [pytest.mark.browser, pytest.mark.long]
COUNT, SIZE = 300, (320, 180)


def _ply(path: Path) -> None:
    gsply = pytest.importorskip("tests.codec.foreign", reason="writes .ply files: pip install gsply").gsply
    rng = np.random.default_rng(1)
    data = gsply.GSData(
        means=rng.normal(0, 1, (COUNT, 3)).astype(np.float32), scales=np.full((COUNT, 3), np.log(0.08), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (COUNT, 1)), opacities=np.full(COUNT, 2.0, np.float32),
        sh0=rng.normal(0, 1, (COUNT, 3)).astype(np.float32), shN=np.zeros((COUNT, 0, 3), np.float32),
    )  # fmt: skip
    gsply.plywrite(str(path), data)


def _fourdgs(path: Path) -> None:
    fourdgs = pytest.importorskip("fourdgs", reason="writes .4dgs files: pip install fourdgs")
    rng = np.random.default_rng(2)
    moving = fourdgs.GaussianSet(
        positions=rng.normal(0, 1, (COUNT, 3)).astype(np.float32), scales=np.full((COUNT, 3), 0.08, np.float32),
        rotations=np.tile(np.array([0, 0, 0, 1], np.float32), (COUNT, 1)),
        colors=np.concatenate([rng.uniform(0, 1, (COUNT, 3)), np.full((COUNT, 1), 0.9)], axis=1).astype(np.float32),
        motions=np.tile(np.array([1, 0, 0], np.float32), (COUNT, 1)), mu_t=np.zeros(COUNT, np.float32),
        sigma_t=np.full(COUNT, np.inf, np.float32), win_lo=np.zeros(COUNT), win_hi=np.full(COUNT, 2.0),
    )  # fmt: skip
    fourdgs.write(str(path), moving, 1.0)


@pytest.mark.parametrize(("name", "write"), [("a.ply", _ply), ("a.4dgs", _fourdgs)])
def test_a_foreign_file_is_seen_on_the_page(
    chromium: Any, clip: Clip, tmp_path: Path, name: str, write: Callable[[Path], None]
) -> None:
    write(tmp_path / name)
    import_files(tmp_path / name, tmp_path / "clip.slod", fps=10)
    states = [frame.scene for frame in decode_frames(tmp_path / "clip.slod")]
    rig = states[0].header.cameras[0]
    share = SIZE[0] / rig.width
    focal, middle = share * np.diag(rig.intrinsics)[:2], share * rig.intrinsics[:2, 2]
    camera = pinhole("page", (focal[0], focal[1]), (middle[0], middle[1]), SIZE, rig.world_to_camera)
    context = chromium.new_context(viewport={"width": SIZE[0], "height": SIZE[1]}, reduced_motion="reduce")
    page = context.new_page()
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?ui=0&quality=high&src=files/clip.slod")
        shows(page, "s.window && s.version !== null")
        page.evaluate("streamlod.pause()")
        for state in (states[0], states[len(states) // 2]):
            page.evaluate(f"streamlod.seek({state.version})")
            shows(page, f"s.version === {state.version}")
            page.evaluate("streamlod.setCamera(0)")
            comes_to_show(page, reference(state, camera))
        context.close()
