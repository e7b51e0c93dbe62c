"""Gradients of the CPU kernels: within 1e-4 of the float64 reference, a bound that a missing term breaks."""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from streamlod.core.render.cpu import frame
from streamlod.core.render.cpu.kernels import backward, project_backward
from tests.core.render.scenes import NAMES, Outcome, make_camera, make_cloud, relative, run

BOUND = 1e-4
# Seeds without a pixel whose alpha lies within a float32's rounding of 1/255: there a contribution is all or nothing.
SCENES = {
    "many": (make_cloud(400, seed=0), make_camera(61, 47)),
    "large": (make_cloud(150, seed=2, size=1.0), make_camera(61, 47)),
    "opaque": (replace(make_cloud(100, seed=4), opacities=np.full(100, 1.2, np.float32)), make_camera(61, 47)),
    "about the camera": (make_cloud(300, seed=3, size=0.4, spread=4.0), make_camera(61, 47)),
}


def largest_error(found: Outcome, wanted: Outcome) -> float:
    """Over all parameters, and the gradients by the projected means."""
    errors = [relative(found.gradients[name], wanted.gradients[name]) for name in NAMES]
    return max(*errors, relative(found.probe.gradients, wanted.probe.gradients))


@pytest.mark.parametrize("scene", SCENES)
def test_gradients_equal_the_reference(scene: str) -> None:
    cloud, camera = SCENES[scene]
    found, wanted = run(cloud, camera), run(cloud, camera, "reference")
    assert torch.equal(found.probe.visible, wanted.probe.visible)
    assert largest_error(found, wanted) < BOUND


@pytest.mark.parametrize("rows", [0, 1, 130, 400, 10_000])
def test_only_the_first_rows_get_gradients(rows: int) -> None:
    cloud, camera = SCENES["many"]
    whole, part, wanted = (run(cloud, camera, b, r) for b, r in (("cpu", None), ("cpu", rows), ("reference", rows)))
    assert torch.equal(whole.image, part.image)
    assert torch.equal(part.probe.visible, wanted.probe.visible)
    for name in NAMES:
        assert not part.gradients[name][rows:].any()
        assert (
            relative(
                part.gradients[name],
                whole.gradients[name] * (torch.arange(400) < rows).view(-1, *[1] * (whole.gradients[name].ndim - 1)),
            )
            < 1e-5
        )


# One term of the gradient each, taken away.
MUTATIONS = {
    "colour behind": (backward, "alpha * behind / (ONE - alpha) - own", "ZERO - own"),
    "own colour": (backward, "alpha * behind / (ONE - alpha) - own", "alpha * behind / (ONE - alpha)"),
    "cap": (backward, "both(alive, above(splat(ALPHA_MAX), full))", "alive"),
    "transmittance": (backward, "light_gradient[y, x] * transmittance[y, x] if with_light else ZERO", "ZERO"),
    "second moment": (backward, "sxy + slope_x * dy", "sxy"),
    "conic of the mean": (project_backward, "-(ca * total[SUM_X] + cb * total[SUM_Y])", "-(ca * total[SUM_X])"),
    "depth in the mean": (
        project_backward,
        "gz = -(fx * slope_x * screen_x + fy * slope_y * screen_y) * inverse_z - ",
        "gz = -",
    ),
    "depth in the Jacobian": (project_backward, "inverse_z2 * (fx * to_ax + fy * to_ay)", "ZERO"),
    "slope in the Jacobian": (project_backward, "gx -= fx * inverse_z2 * to_bx", "gx -= fx * ZERO"),
    "clamped slope": (project_backward, "if held_x == slope_x:", "if True:"),
    "quaternion length": (project_backward, "out[0], out[1] = (dw - w * along)", "out[0], out[1] = (dw)"),
    "third scale": (project_backward, "to_scales[i, 2] = u2 * a2 + v2 * b2", "to_scales[i, 2] = u2 * a2"),
}


@pytest.mark.slow  # each compiles a kernel
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_missing_term_breaks_the_bound(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module, term, instead = MUTATIONS[name]
    mutant = mutated(module, term, instead, tmp_path)
    for kernel in ("differentiate_tiles", "differentiate_projection"):
        if hasattr(mutant, kernel):
            monkeypatch.setattr(frame, kernel, getattr(mutant, kernel))
    errors = [largest_error(run(*scene), run(*scene, "reference")) for scene in SCENES.values()]
    assert max(errors) > BOUND, f"nothing noticed that {name} was missing"


def mutated(module: ModuleType, term: str, instead: str, folder: Path) -> ModuleType:
    """`module` with one expression replaced, compiled afresh."""
    assert module.__file__ is not None
    source = Path(module.__file__).read_text()
    assert term in source
    for extra in ("ZERO", "ONE"):
        if f"    {extra},\n" not in source:
            source = source.replace("    TWO,\n", f"    {extra},\n    TWO,\n", 1)
    path = folder / "mutant.py"
    path.write_text(source.replace(term, instead).replace("**KERNEL", "**{**KERNEL, 'cache': False}"))
    spec = importlib.util.spec_from_file_location("mutant", path)
    assert spec is not None
    assert spec.loader is not None
    mutant = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutant)
    return mutant
