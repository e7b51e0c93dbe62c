"""The page finds along a ray what the reference rule finds, on the same scenes."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.arrays import Float64
from streamlod.core.render.pick import depth_along, pick
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import anchor_positions, expand
from streamlod.core.scene.gaussians import GaussianCloud
from tests.client.web.scenes import make_scene

HERE = Path(__file__).parent


@pytest.mark.parametrize("view_dependent", [False, True])
def test_the_page_picks_by_the_reference_rule(node: str, kernel: bytes, tmp_path: Path, view_dependent: bool) -> None:
    scene = _with_needles(make_scene(400, view_dependent))
    with SlodWriter(tmp_path / "a.slod") as writer:
        writer.append(encode_keyframe(scene, time_ns=0))
    generator = np.random.default_rng(3)
    targets = np.concatenate([generator.uniform(-1.5, 1.5, (30, 3)), np.full((2, 3), 50.0)])
    rays = []
    for number, target in enumerate(targets):
        origin = np.array([0.3, -0.2, -2.5]) + generator.normal(0, 0.1, 3)
        if number % 3 == 0:
            origin = generator.normal(0, 0.5, 3)  # amid the scene, far from the cameras
        rays.append((origin, (target - origin) / np.linalg.norm(target - origin)))
    (tmp_path / "rays.json").write_text(json.dumps([[origin.tolist(), ray.tolist()] for origin, ray in rays]))
    command = [node, "picks.mjs", str(tmp_path / "a.slod"), str(tmp_path / "rays.json"), str(tmp_path / "out.json")]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    anchors = np.concatenate([anchor_positions(scene.header, n, level) for n, level in enumerate(scene.levels)])
    hits, hidden, through = 0, 0, 0
    answers = json.loads((tmp_path / "out.json").read_text())
    for (origin, ray), (point, depth, splats) in zip(rays, answers, strict=True):
        cloud = expand(scene, origin)
        assert splats == ((cloud.opacities >= 1 / 255) & (cloud.means[:, 2] - origin[2] >= 0.01)).sum()
        everything = expand(replace(scene, header=replace(scene.header, cameras=())), origin)
        hidden += len(everything) - len(cloud)
        mine = pick(cloud, origin, ray)
        through += _differ(mine, _pick_all(cloud, origin, ray))
        assert (mine is None) == (point is None)
        if mine is not None:
            hits += 1
            np.testing.assert_allclose(point, mine, atol=1e-3)
        assert depth == pytest.approx(depth_along(anchors, origin, ray), abs=1e-4)
    assert 3 < hits < len(rays)
    assert hidden > 100
    assert through > 1  # rays meet needles that are not drawn


def _with_needles(scene: Scene) -> Scene:
    """Every 25th anchor's Gaussians are made 30 times as long, some of them along the rays."""
    levels = []
    for level in scene.levels:
        scaling = level.scaling.copy()
        scaling[::25, 3] += round(np.log(30) / scene.header.scaling_steps[3])
        levels.append(replace(level, scaling=scaling))
    return replace(scene, levels=tuple(levels))


def _pick_all(cloud: GaussianCloud, origin: Float64, ray: Float64) -> Float64 | None:
    """As `pick`, but hits what reaches far along the ray as well."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("streamlod.core.render.pick.MAX_SPREAD", np.inf)
        return pick(cloud, origin, ray)


def _differ(one: Float64 | None, other: Float64 | None) -> bool:
    return (one is None) != (other is None) or (one is not None and not np.array_equal(one, other))
