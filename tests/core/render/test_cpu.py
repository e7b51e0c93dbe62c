"""The CPU kernels' pictures: like the oracle's, the same every time, from any thread, and no torch needed."""

import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.errors import InputError
from streamlod.core.render import rasterise
from streamlod.core.render.cpu import render
from streamlod.core.render.cpu.workspace import POOL
from streamlod.core.scene.gaussians import GaussianCloud
from tests.core.render.scenes import BACKGROUND, NAMES, make_camera, make_cloud, run
from tests.threads import MAX_THREADS, kernel_threads

SIZES = [(48, 40), (1, 1), (33, 17), (64, 32), (131, 5), (9, 50)]


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_picture_equals_the_reference(width: int, height: int) -> None:
    cloud, camera = make_cloud(200, seed=1), make_camera(width, height, focal=45.0)
    found, wanted = run(cloud, camera), run(cloud, camera, "reference")
    assert float((found.image - wanted.image).abs().max()) < 1e-5
    assert float((found.transmittance - wanted.transmittance).abs().max()) < 1e-5
    assert torch.equal(found.probe.visible, wanted.probe.visible)


def test_numpy_entry_equals_the_training_interface() -> None:
    cloud, camera = make_cloud(300), make_camera(90, 70)
    rendered, trained = render(cloud, camera, BACKGROUND), run(cloud, camera)
    assert np.array_equal(rendered.image, trained.image.numpy().astype(np.float32))
    assert np.array_equal(rendered.transmittance, trained.transmittance.numpy().astype(np.float32))


def test_nothing_to_draw_gives_the_background() -> None:
    rendered = render(make_cloud(0), make_camera(), BACKGROUND)
    assert np.array_equal(rendered.image, np.broadcast_to(BACKGROUND, rendered.image.shape))
    assert (rendered.transmittance == 1).all()


def test_order_of_rows_is_no_order_of_depth() -> None:
    cloud, camera = make_cloud(300, size=0.4), make_camera()
    shuffled = np.random.default_rng(3).permutation(len(cloud))
    other = GaussianCloud(*(np.ascontiguousarray(getattr(cloud, name)[shuffled]) for name in NAMES))
    assert np.array_equal(render(cloud, camera, BACKGROUND).image, render(other, camera, BACKGROUND).image)


def test_same_bits_every_time_and_the_same_picture_for_any_threads() -> None:
    cloud, camera = make_cloud(2000, size=0.2), make_camera(160, 120)
    with kernel_threads(MAX_THREADS):
        first, second = run(cloud, camera), run(cloud, camera)
    for name in NAMES:
        assert torch.equal(first.gradients[name], second.gradients[name])
    with kernel_threads(1):
        alone = run(cloud, camera)
    assert torch.equal(alone.image, first.image)
    for name in NAMES:
        assert torch.allclose(alone.gradients[name], first.gradients[name], rtol=1e-3, atol=1e-4)


def test_two_threads_may_render_at_once() -> None:
    clouds, camera = [make_cloud(1500, seed=s) for s in range(4)], make_camera(120, 90)
    wanted = [run(cloud, camera) for cloud in clouds]
    found: dict[int, bool] = {}

    def work(k: int) -> None:
        same = True
        for _ in range(5):
            outcome = run(clouds[k], camera)
            same &= torch.equal(outcome.image, wanted[k].image)
            same &= all(torch.equal(outcome.gradients[n], wanted[k].gradients[n]) for n in NAMES)
        found[k] = same

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(found.get(k) for k in range(4))


def test_several_pictures_may_wait_for_their_backward_pass() -> None:
    cloud = make_cloud(100)
    cameras = [make_camera(40, 30), make_camera(64, 48), make_camera(33, 57)]
    parameters = [torch.tensor(getattr(cloud, name), requires_grad=True) for name in NAMES]
    together = sum((rasterise(*parameters, c, torch.zeros(3)).image.square().sum() for c in cameras), torch.zeros(()))
    together.backward()
    grad = parameters[0].grad
    assert grad is not None
    apart = torch.zeros_like(grad)
    for camera in cameras:
        leaves = [p.detach().requires_grad_() for p in parameters]
        rasterise(*leaves, camera, torch.zeros(3)).image.square().sum().backward()
        assert leaves[0].grad is not None
        apart += leaves[0].grad
    assert torch.allclose(grad, apart, rtol=1e-4, atol=1e-5)


def test_a_picture_is_differentiated_once_and_not_changed_in_place() -> None:
    cloud, camera = make_cloud(20), make_camera()
    parameters = [torch.tensor(getattr(cloud, name), requires_grad=True) for name in NAMES]
    raster = rasterise(*parameters, camera, torch.zeros(3))
    with pytest.raises(RuntimeError, match="only after backward"):
        _ = raster.probe.gradients
    loss = raster.image.sum()
    loss.backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="once only"):
        loss.backward()
    raster = rasterise(*parameters, camera, torch.zeros(3))
    raster.image.mul_(2)
    with pytest.raises(RuntimeError, match="inplace"):
        raster.image.sum().backward()


def test_workspaces_come_back() -> None:
    cloud, camera = make_cloud(50), make_camera()
    run(cloud, camera)
    workspace = POOL.acquire()
    POOL.release(workspace)
    run(cloud, camera)  # with a backward pass
    parameters = [torch.tensor(getattr(cloud, name), requires_grad=True) for name in NAMES]
    raster = rasterise(*parameters, camera, torch.zeros(3))
    del raster  # without
    assert POOL.acquire() is workspace
    POOL.release(workspace)


def test_lens_distortion_is_refused() -> None:
    camera = replace(make_camera(), distortion=np.array([0.1, 0, 0, 0, 0]))
    with pytest.raises(InputError, match="undistort"):
        render(make_cloud(), camera, BACKGROUND)
    with pytest.raises(InputError, match="undistort"):
        run(make_cloud(), camera)


def test_shapes_are_checked() -> None:
    cloud = make_cloud(4)
    parameters = [torch.tensor(getattr(cloud, name)) for name in NAMES]
    with pytest.raises(ValueError, match=r"scales must have shape \(4, 3\)"):
        rasterise(*parameters[:2], parameters[2][:3], *parameters[3:], make_camera(), torch.zeros(3))
    with pytest.raises(ValueError, match="tile_mask"):
        rasterise(*parameters, make_camera(), torch.zeros(3), tile_mask=torch.ones(2, 2, dtype=torch.bool))


def test_clients_need_no_torch() -> None:
    code = (
        "import sys, core.render, core.render.cpu, core.render.cpu.dirty_tiles\n"
        "heavy = {'torch', 'fastapi'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_package_itself_is_light() -> None:
    code = "import sys, core.render; assert not {'torch', 'numba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
