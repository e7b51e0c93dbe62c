"""The rasteriser in Warp as training calls it, against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp

from streamlod.core.camera import pinhole
from streamlod.core.errors import ModelError
from streamlod.core.render import Backend, rasterise
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import preset
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.keyframe.seeding import seed_field
from streamlod.core.train.keyframe.trainer import KeyframeTrainer
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.presets.settings import with_settings
from tests.core.render.scenes import BACKGROUND, NAMES, make_camera, make_cloud, relative, run
from tests.core.render.test_extremes import sheets
from tests.core.render.test_gradients import BOUND, SCENES, largest_error
from tests.core.true_points import true_points

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

BACKENDS: tuple[Backend, ...] = ("cpu", "warp")


@pytest.mark.parametrize("scene", SCENES)
def test_pictures_and_gradients_equal_the_reference(scene: str) -> None:
    cloud, camera = SCENES[scene]
    found, wanted = run(cloud, camera, "warp"), run(cloud, camera, "reference")
    assert float((found.image - wanted.image).abs().max()) < 1e-5
    assert float((found.transmittance - wanted.transmittance).abs().max()) < 1e-5
    assert torch.equal(found.probe.visible, wanted.probe.visible)
    assert largest_error(found, wanted) < BOUND


@pytest.mark.cuda
@pytest.mark.skipif(not wp.is_cuda_available(), reason="there is no GPU")
@pytest.mark.parametrize("scene", SCENES)
def test_on_a_gpu_they_equal_the_reference(scene: str) -> None:
    cloud, camera = SCENES[scene]
    found, wanted = run(cloud, camera, "warp", device="cuda"), run(cloud, camera, "reference")
    assert float((found.image - wanted.image).abs().max()) < 1e-4
    assert max(relative(found.gradients[name], wanted.gradients[name]) for name in NAMES) < 1e-3
    assert relative(found.probe.gradients.double().cpu(), wanted.probe.gradients) < 1e-3


@pytest.mark.parametrize("rows", [0, 1, 130, 400, 10_000])
def test_only_the_first_rows_get_gradients(rows: int) -> None:
    cloud, camera = SCENES["many"]
    found, wanted = run(cloud, camera, "warp", rows), run(cloud, camera, "reference", rows)
    assert float((found.image - wanted.image).abs().max()) < 1e-5
    assert torch.equal(found.probe.visible, wanted.probe.visible)
    for name in NAMES:
        assert not found.gradients[name][rows:].any()
        assert relative(found.gradients[name], wanted.gradients[name]) < BOUND


# quaternions of any length are right, so that 1e30 is not odd there
ODD = [(name, value) for name in NAMES for value in (np.nan, np.inf, -np.inf, 1e30, 0.0)]
ODD.remove(("quaternions", 1e30))


@pytest.mark.parametrize(("name", "value"), ODD)
def test_odd_numbers_do_what_the_cpu_does(name: str, value: float) -> None:
    cloud, camera = make_cloud(60), make_camera()
    values = getattr(cloud, name).copy()
    values[:12] = value
    odd = replace(cloud, **{name: values})
    found, wanted = run(odd, camera, "warp"), run(odd, camera)
    assert float((found.image - wanted.image).abs().max()) < 1e-4
    for each in NAMES:
        assert found.gradients[each].isfinite().all()
        assert relative(found.gradients[each], wanted.gradients[each]) < BOUND


@pytest.mark.parametrize("length", [1e9, 1e10, 1e12])  # units, of ten pixels each
def test_needles_beyond_all_integers_are_drawn(length: float) -> None:
    camera, one = pinhole("axis", (50.0, 50.0), (50.0, 40.0), (100, 80), np.eye(4)), make_cloud(1)
    facing, wide = np.float32([[1, 0, 0, 0]]), np.float32([[length, 2, 0.01]])
    needle = replace(one, means=np.float32([[0, 0, 5]]), quaternions=facing, scales=wide, opacities=np.float32([0.8]))
    found, wanted = run(needle, camera, "warp"), run(needle, camera, "reference")
    assert float((found.image - wanted.image).abs().max()) < 1e-5


def test_nothing_shows_the_background() -> None:
    nothing = GaussianCloud(*(np.zeros((0, *getattr(make_cloud(1), name).shape[1:]), np.float32) for name in NAMES))
    found = run(nothing, make_camera(), "warp")
    assert np.allclose(found.image.numpy(), BACKGROUND)
    assert (found.transmittance == 1).all()


def test_pictures_outlive_their_gradients() -> None:
    cloud, camera = SCENES["many"]
    parameters, behind = [torch.tensor(getattr(cloud, name)) for name in NAMES], torch.tensor(BACKGROUND)
    drawn = [rasterise(*parameters, camera, behind, backend="warp").image for _ in range(20)]
    assert all(torch.equal(picture, drawn[0]) for picture in drawn)
    assert not drawn[0].requires_grad


def test_a_first_frame_trains_as_on_the_cpu() -> None:
    spec = SyntheticSpec(cameras=3, frames=1, width=64, height=36, seed=2)
    clip = open_synthetic(spec)
    frame, config = next(iter(clip.frames())), with_settings(preset("live"), {"keyframe.steps": 24})
    points, views = true_points(spec), Views(clip.cameras, torch.from_numpy(frame.images) / 255, [0, 1, 2])
    losses = dict[Backend, list[float]]()
    for backend in BACKENDS:
        field = seed_field(points, clip.cameras, config.model, torch.Generator().manual_seed(0))
        trainer = KeyframeTrainer(field, views, config, backend, neutral(3), field.octree.motion_cell)
        losses[backend] = [float(trainer.step()) for _ in range(24)]
        assert trainer.broken == 0
    assert losses["warp"][:5] == pytest.approx(losses["cpu"][:5], rel=1e-3)
    assert np.mean(losses["warp"][-8:]) == pytest.approx(np.mean(losses["cpu"][-8:]), rel=0.1)


def test_more_pairs_than_memory_holds_are_refused() -> None:
    wide = sheets(make_cloud(8400, spread=0.3), 50.0)  # 16,384 tiles each
    with pytest.raises(ModelError, match="scales are out of hand"):
        run(wide, make_camera(2048, 2048), "warp")
