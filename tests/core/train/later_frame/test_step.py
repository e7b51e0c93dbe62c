"""A training step on a GPU leaves the host free: it asks for no number and sends none.

Run on torch's `meta` device, which has shapes but no numbers: whoever asks for one gets an error, as does everything
that mixes devices. gsplat's kernels need a GPU, so that what they return is made of torch operations here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import streamlod.core.render.cuda
from streamlod.core.camera import pinhole
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.later_frame.state import State
from streamlod.core.train.later_frame.training import FrameTraining
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field
from tests.core.train.later_frame.begun import bare_state, training_of

WIDTH, HEIGHT = 40, 24


class NoNumbers(TorchFunctionMode):
    """Refuses to make tensors of the host's numbers."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if function in (torch.tensor, torch.as_tensor, torch.from_numpy):
            raise AssertionError("numbers of the host are sent")
        return function(*args, **(kwargs or {}))


class NoMemory(TorchDispatchMode):
    """Refuses operations that touch the host's memory."""

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **(kwargs or {}))
        for value in tree_leaves((args, kwargs, result)):
            if isinstance(value, Tensor) and value.device.type == "cpu":
                raise AssertionError(f"{function} touches the host's memory")
        return result


def test_the_mode_sees_what_makes_a_host_wait() -> None:
    numbers = torch.ones(3, device="meta")
    asking: list[Callable[[], Any]] = [
        lambda: torch.tensor([1.0, 2.0], device="meta"),
        lambda: torch.ones(3).to("meta"),
        lambda: float(numbers.sum()),
        lambda: torch.nonzero(numbers),
        lambda: numbers[numbers > 0],
        numbers.cpu,
        lambda: bool((numbers > 0).any()),
    ]
    for ask in asking:
        with NoNumbers(), NoMemory(), pytest.raises((AssertionError, RuntimeError, NotImplementedError)):
            ask()
    with NoNumbers(), NoMemory():
        _ = (numbers * 2).sum() / 3


@pytest.mark.parametrize("view_dependent", [False, True])
def test_a_step_asks_the_device_for_nothing(monkeypatch: pytest.MonkeyPatch, view_dependent: bool) -> None:
    monkeypatch.setattr(streamlod.core.render.cuda, "_gsplat", lambda: splat)
    trainer = on_meta(prepared(view_dependent))
    assert isinstance(trainer, FrameTraining)
    trainer.engine.step(0, 1.0, counts=False)  # constants of the camera and of the tables are sent once
    before = trainer.anchors.optimiser.parameters["latent"]
    with NoNumbers(), NoMemory():
        loss, _ = trainer.engine.step(0, 0.9, counts=False)
    assert loss.device.type == "meta"
    assert trainer.anchors.optimiser.parameters["latent"] is before


def prepared(view_dependent: bool) -> FrameTraining:
    """A trainer on the CPU of which one view is planned for the cuda backend."""
    pose = np.eye(4)
    pose[2, 3] = 3.0
    camera = pinhole("cam00", (WIDTH, WIDTH), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), pose)
    field = random_field(60, view_dependent=view_dependent)
    state: State = bare_state(scene_of(field, PredictConfig(), (camera,), 30.0, 0))
    some = np.arange(len(field)) % 3 == 0
    views = Views((camera,), torch.rand(1, HEIGHT, WIDTH, 3), [0])
    masks = torch.ones(1, HEIGHT, WIDTH, dtype=torch.bool)
    trainer = training_of(state, some, views, masks, backend="cuda", config=PredictConfig(rate_weight=0.005))
    trainer.engine.plan(0)
    return trainer


def on_meta(value: Any) -> Any:
    """`value` with every tensor in it on the meta device, leaves still leaves."""
    if isinstance(value, Tensor):
        return value.detach().to("meta").requires_grad_(value.requires_grad)
    if isinstance(value, torch.device):
        return torch.device("meta")
    if isinstance(value, dict):
        return {key: on_meta(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return type(value)(on_meta(item) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: on_meta(getattr(value, field.name)) for field in fields(value)})
    if type(value).__module__.startswith("streamlod.core.train"):
        for name, item in vars(value).items():
            setattr(value, name, on_meta(item))
    return value


def splat(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, **options: Any
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """What gsplat's `rasterization` returns in its packed mode, differentiable by all five; everything is visible."""
    pose, width, height = options["viewmats"][0], options["width"], options["height"]
    assert options["packed"]
    points = (means @ pose[:3, :3].T + pose[:3, 3])[:, :2]
    weight = opacities * (points.square().sum(dim=1) + scales.sum(dim=1) + quats.sum(dim=1))
    colour = (weight[:, None] * colors).sum(dim=0)
    light = weight.sum().sigmoid().expand(1, height, width, 1)
    ids = torch.arange(len(means), device=means.device)
    return colour.expand(1, height, width, 3), light, {"means2d": points, "gaussian_ids": ids}
