"""What the cuda backend does around gsplat, run on the CPU: gsplat's kernels by the reference, in its packed layout.

The stand-in has the interface of gsplat 1.5.3 as it is published: arguments, shapes, what `meta` holds. Whether
gsplat's own kernels agree is for `test_cuda.py`, on a GPU.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import streamlod.core.render.cuda
from streamlod.core.camera import pinhole
from streamlod.core.render.reference import _visible, blend, project
from tests.core.render.scenes import BACKGROUND, NAMES, make_camera, make_cloud, relative, run


def rasterization(
    means: Tensor,  # [N,3]
    quats: Tensor,  # [N,4]
    scales: Tensor,  # [N,3]
    opacities: Tensor,  # [N]
    colors: Tensor,  # [N,3]
    viewmats: Tensor,  # [1,4,4]
    Ks: Tensor,  # [1,3,3]  # noqa: N803
    width: int,
    height: int,
    near_plane: float,
    far_plane: float,
    eps2d: float,
    rasterize_mode: str,
    packed: bool,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    assert (near_plane, far_plane, eps2d, rasterize_mode, packed) == (0.01, 1e10, 0.1, "classic", True)
    k = Ks[0].double().numpy()
    focal, centre = (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2])
    camera = pinhole("gsplat", focal, centre, (width, height), viewmats[0].double().numpy())
    given = [parameter.double() for parameter in (means, quats, scales, opacities, colors)]
    with torch.no_grad():
        rows = _visible(*given, camera)
    m, q, s, o, c = (parameter[rows] for parameter in given)
    mean, covariance, depth = project(m, q, s, camera)
    means2d = mean.float()
    order = torch.argsort(depth, stable=True)
    black = torch.zeros(3, dtype=torch.float64)
    image, light = blend(means2d.double()[order], covariance[order], o[order], c[order], black, width, height)
    return image.float()[None], (1 - light).float()[None, ..., None], {"means2d": means2d, "gaussian_ids": rows}


@pytest.fixture(autouse=True)
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streamlod.core.render.cuda, "_gsplat", lambda: rasterization)


@pytest.mark.parametrize("moving", [None, 25])
def test_picture_gradients_and_probe_equal_the_reference(moving: int | None) -> None:
    cloud, camera = make_cloud(80), make_camera()
    found, wanted = (run(cloud, camera, backend, gradient_rows=moving) for backend in ("cuda", "reference"))
    assert float((found.image - wanted.image).abs().max()) < 1e-5
    assert float((found.transmittance - wanted.transmittance).abs().max()) < 1e-5
    for name in NAMES:
        assert relative(found.gradients[name], wanted.gradients[name]) < 1e-4, name
    assert torch.equal(found.probe.visible, wanted.probe.visible)
    assert relative(found.probe.gradients, wanted.probe.gradients) < 1e-4


def test_nothing_in_sight_is_the_background() -> None:
    cloud, camera = make_cloud(10), make_camera()
    cloud.opacities[:] = 0
    found = run(cloud, camera, "cuda")
    assert torch.equal(found.image, torch.tensor(BACKGROUND).double().expand(found.image.shape))
    assert len(found.probe.visible) == 0
