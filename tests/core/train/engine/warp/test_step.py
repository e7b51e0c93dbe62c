"""A whole step in Warp against float64 torch; replayed, it is the launched one, and nothing in it needs the host."""

from __future__ import annotations

import gc
import inspect
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest
import torch
import warp as wp
from torch import Tensor

from streamlod.core.errors import ModelError
from streamlod.core.render.warp.kernels import blend_adjoint
from streamlod.core.train.engine.warp.frame import begin, load_pictures
from streamlod.core.train.engine.warp.kernels import loss, rate
from streamlod.core.train.engine.warp.room import view_of
from streamlod.core.train.engine.warp.step import TrainingStep
from tests.core.train.engine.warp.rooms import (
    ADDED,
    ADDED_RATES,
    ANCHORS,
    FEATURES,
    RATES,
    SLOTS,
    TOLD,
    SmallFrame,
    relative,
    small_frame,
)
from tests.core.train.references import update_reference

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

BOUND = 1e-4


@pytest.fixture(scope="module")
def frame() -> SmallFrame:
    return small_frame()


def parts_of(numbers: Tensor) -> tuple[Tensor, ...]:
    """Features, offsets, scalings and places of new anchors [m,F+3K+9]."""
    return torch.split(numbers, [FEATURES, 3 * SLOTS, 6, 3], dim=1)


def numbers(array: Any) -> Tensor:
    """[n,27] the anchors' rows of a flat array."""
    return view_of(array).view(-1, 27)[:ANCHORS].clone()


@pytest.mark.parametrize("view_dependent", [False, True])
def test_gradients_of_a_step_equal_the_reference(view_dependent: bool) -> None:
    frame, cameras = small_frame(view_dependent=view_dependent), (2, 0)
    room = frame.loaded(2)
    step = TrainingStep(room)
    step.tell(0, TOLD, cameras)
    step.show()
    given = frame.latent.double(), frame.position.double(), frame.values.double()
    for view, camera in enumerate(cameras):
        wanted = frame.picture(frame.splats(*given, camera), camera)
        assert float((view_of(room.drawn.image)[view].double() - wanted).abs().max()) < 1e-5
    step.judge()
    step.pull()
    loss, anchors, added = frame.gradients(cameras)
    found = numbers(room.trained.gradient)
    assert relative(found[:, :12], anchors[:, :12]) < BOUND
    assert relative(found[:, 12:24], anchors[:, 12:24]) < BOUND
    assert relative(found[:, 24:], anchors[:, 24:]) < BOUND
    step.update()
    moved = view_of(room.trained_added.first)[:ADDED] / 0.4  # the first moment holds the gradient
    for part, wanted in zip(parts_of(moved), parts_of(added), strict=True):
        assert relative(part, wanted) < BOUND
    assert float(view_of(room.trained.losses)[0]) == pytest.approx(loss, rel=1e-5)
    assert not view_of(room.trained.totals).any()
    assert not view_of(room.trained.gradient).any()


def test_a_step_is_adams_and_counts_into_the_mean(frame: SmallFrame) -> None:
    room = frame.loaded(1)
    step = TrainingStep(room)
    told = list(TOLD)
    told[5] = 0.5
    step.tell(0, told, (1,))
    before = numbers(room.trained.values)
    step.show()
    step.judge()
    step.pull()
    gradients = numbers(room.trained.gradient)
    step.update()
    after, mean = numbers(room.trained.values), numbers(room.trained.mean)
    parts = ((before[:, :24], gradients[:, :24]), (before[:, 24:], gradients[:, 24:]))
    wanted = []
    for (value, gradient), own in zip(parts, RATES, strict=True):
        new = value.clone()
        update_reference(new, gradient, *torch.zeros(2, *new.shape), own, 1 - 0.999, 0.6)
        wanted.append(new)
    assert torch.allclose(after, torch.cat(wanted, dim=1), rtol=2e-6, atol=1e-6)
    assert torch.equal(mean, 0.5 * after)
    added = room.trained_added
    now, pulled = (view_of(array)[:ADDED].clone() for array in (added.values, added.first))
    for value, moved, pull, own in zip(*map(parts_of, (frame.values, now, pulled / 0.4)), ADDED_RATES, strict=True):
        new = value.clone()
        update_reference(new, pull, *torch.zeros(2, *new.shape), own, 1 - 0.999, 0.6)
        assert torch.allclose(moved, new, rtol=2e-6, atol=1e-5)
    assert torch.equal(view_of(added.mean)[:ADDED], 0.5 * now)


def test_a_broken_gradient_is_counted_and_changes_nothing(frame: SmallFrame) -> None:
    room = frame.loaded(1)
    step = TrainingStep(room)
    step.tell(0, TOLD, (1,))
    before = view_of(room.trained.values).clone()
    gradient = view_of(room.trained.gradient)
    gradient[3], gradient[40], gradient[41] = torch.nan, torch.inf, -torch.inf
    step.update()
    assert torch.equal(view_of(room.trained.values), before)
    assert int(room.trained.broken.numpy()[0]) == 3


def test_replayed_steps_equal_launched_ones_after_all_inputs_changed() -> None:
    first, second = (small_frame(view_dependent=True, seed=seed) for seed in (1, 2))
    second = replace(second, trained=replace(second.trained, reference_distance=4.0))
    cameras = (0, 1), (2, 0), (1, 2)
    replayed, launched = TrainingStep(first.loaded(2)), TrainingStep(second.loaded(2))
    for number in range(3):  # the first is launched and recorded
        replayed.run(number, TOLD, cameras[number])
    second.load(replayed.room)
    for number in range(3):
        replayed.run(number, TOLD, cameras[number])
        launched.tell(number, TOLD, cameras[number])
        launched.launch()
    for name in ("values", "first", "second", "mean", "losses"):
        arrays = (view_of(getattr(step.room.trained, name)) for step in (replayed, launched))
        assert torch.equal(*arrays), name
    assert torch.equal(view_of(replayed.room.drawn.image), view_of(launched.room.drawn.image))


@pytest.mark.cuda
@pytest.mark.skipif(not wp.is_cuda_available(), reason="there is no GPU")
@pytest.mark.parametrize("view_dependent", [False, True])
def test_steps_on_a_gpu_launched_and_replayed_are_those_of_the_cpu(view_dependent: bool) -> None:
    frame, cameras = small_frame(view_dependent=view_dependent), (2, 0)
    here, there = (TrainingStep(frame.loaded(2, device)) for device in ("cpu", "cuda"))
    here.run(0, TOLD, cameras)
    for _ in range(3):  # the first is launched and recorded
        there.run(0, TOLD, cameras)
        for name in ("first", "second"):
            one, other = (view_of(getattr(step.room.trained, name)).cpu() for step in (here, there))
            assert relative(other, one.double()) < 1e-3
        one, other = (view_of(step.room.trained.losses).cpu()[0] for step in (here, there))
        assert float(other) == pytest.approx(float(one), rel=1e-4)
        assert float((view_of(there.room.drawn.image).cpu() - view_of(here.room.drawn.image)).abs().max()) < 1e-4
        frame.load(there.room)  # all as it was


@contextmanager
def nothing_but_kernels(patch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail where the host reads, waits, or takes memory of a device."""

    def refuse(name: str) -> Any:
        def refused(*_: Any, **__: Any) -> None:
            raise AssertionError(f"{name} while a step is recorded")

        return refused

    with patch.context() as inside:
        for name in ("numpy", "list", "assign", "__init__"):
            inside.setattr(wp.array, name, refuse(f"array.{name}"))
        for name in ("synchronize", "synchronize_device", "synchronize_stream", "to_torch", "from_torch"):
            inside.setattr(wp, name, refuse(name))
        yield


def test_a_step_is_recorded_without_the_host(frame: SmallFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    step = TrainingStep(frame.loaded(2))
    step.run(0, TOLD, (0, 1))
    with nothing_but_kernels(monkeypatch):
        step.recorded()


def test_no_garbage_is_collected_while_a_step_is_recorded(frame: SmallFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    step, rounds, threshold = TrainingStep(frame.loaded(1)), list[str](), gc.get_threshold()
    launch, inside = step.launch, list[str]()

    def launched() -> None:
        rounds.clear()
        launch()
        inside.extend(rounds)

    def note(phase: str, _info: dict[str, int]) -> None:
        rounds.append(phase)

    monkeypatch.setattr(step, "launch", launched)
    gc.callbacks.append(note)
    gc.set_threshold(1)
    try:
        step.tell(0, TOLD, (1,))
        step.launch()
        assert inside  # so that it would be noticed
        inside.clear()
        step.recorded()
        assert gc.isenabled()
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(note)
    assert not inside


@pytest.mark.parametrize("what", ["read", "wait", "take memory"])
def test_the_guard_notices(what: str, frame: SmallFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    step = TrainingStep(frame.loaded(2))
    step.run(0, TOLD, (0, 1))
    totals = step.room.trained.totals
    judge = step.judge

    def offending() -> None:
        judge()
        if what == "read":
            totals.numpy()
        elif what == "wait":
            wp.synchronize()
        else:
            wp.zeros(3, dtype=float, device="cpu")

    monkeypatch.setattr(step, "judge", offending)
    with nothing_but_kernels(monkeypatch), pytest.raises(AssertionError, match="while a step is recorded"):
        step.recorded()


@pytest.mark.parametrize("size", [(96, 54), (75, 41), (33, 17)])
def test_kernels_whose_lanes_add_up_are_launched_for_whole_warps(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    frame, launched = small_frame(size=size), dict[str, tuple[int, ...]]()
    step, launch = TrainingStep(frame.loaded(1)), wp.launch
    step.tell(0, TOLD, (1,))

    def noting(kernel: Any, dim: Any, **named: Any) -> None:
        launched[kernel.key] = dim if isinstance(dim, tuple) else (dim,)
        launch(kernel, dim=dim, **named)

    monkeypatch.setattr(wp, "launch", noting)
    step.launch()
    using = {name for module in (loss, rate, blend_adjoint) for name in kernels_with_lanes(module)}
    assert using == {"compare", "gather", "differentiate_blend"}
    assert {name: math.prod(launched[name]) % 32 for name in using} == dict.fromkeys(using, 0)
    assert numbers(step.room.trained.values).isfinite().all()


def kernels_with_lanes(module: ModuleType) -> list[str]:
    """Kernels of a module whose source adds up over lanes."""
    kernels = (value for value in vars(module).values() if isinstance(value, wp.Kernel))
    return [kernel.key for kernel in kernels if "lanes_sum(" in inspect.getsource(kernel.func)]


def test_steps_make_the_loss_fall(frame: SmallFrame) -> None:
    room = frame.loaded(3)
    step = TrainingStep(room)
    begin(room, torch.zeros_like(frame.latent), torch.zeros_like(frame.position))
    step.tell(0, TOLD, (0, 1, 2))
    step.show()
    goal = view_of(room.drawn.image).clone()
    load_pictures(room, goal, torch.zeros_like(goal), None)
    begin(room, frame.latent, frame.position)
    for number in range(30):
        told = list(TOLD)
        told[:2], told[2] = [rate / (1 - 0.6 ** (number + 1)) for rate in RATES], 1 / (1 - 0.999 ** (number + 1))
        step.run(number, told, (0, 1, 2))
    losses = view_of(room.trained.losses)[:30]
    assert losses.isfinite().all()
    assert float(losses[-5:].mean()) < 0.6 * float(losses[0])


def test_too_few_pairs_are_told_and_lose_nothing(frame: SmallFrame) -> None:
    plenty, short = (TrainingStep(frame.loaded(3, **few)) for few in ({}, {"moving_pairs": 64}))
    for step in (plenty, short):
        step.run(0, TOLD, (0, 1, 2))
        step.run(1, TOLD, (0, 1, 2))
    assert plenty.room.moving.overflow == 0
    assert short.room.moving.overflow > 0
    assert numbers(short.room.trained.values).isfinite().all()
    assert int(short.room.trained.broken.numpy()[0]) == 0


@pytest.mark.parametrize(
    ("change", "what"), [({"anchors": 5}, "anchors"), ({"still": 3}, "stand still"), ({"added": 2}, "added")]
)
def test_what_is_too_much_is_refused(frame: SmallFrame, change: dict[str, int], what: str) -> None:
    with pytest.raises(ModelError, match=what):
        frame.loaded(1, **change)


def test_still_gaussians_that_reach_too_many_tiles_are_told(frame: SmallFrame) -> None:
    assert frame.loaded(1).still.overflow == 0
    assert frame.loaded(1, still_pairs=50).still.overflow > 0


def test_steps_beyond_the_frame_are_refused(frame: SmallFrame) -> None:
    step = TrainingStep(frame.loaded(1))
    for number, cameras in ((40, (0,)), (-1, (0,)), (0, (0, 1))):
        with pytest.raises(ValueError, match="step"):
            step.run(number, TOLD, cameras)
