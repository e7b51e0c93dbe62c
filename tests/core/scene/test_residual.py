"""Differences of states: inverse of `apply`, additive, strict."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import LevelResidual, apply, difference
from tests.codec.scenes import assert_same_state, grow, make_scene, move

START = make_scene((6, 40), slots=1, features=2)
moves = st.lists(st.tuples(st.sampled_from(["move", "grow"]), st.integers(0, 99)), min_size=2, max_size=5)


def _walk(scene: Scene, steps: list[tuple[str, int]]) -> list[Scene]:
    states = [scene]
    for kind, seed in steps:
        states.append(move(states[-1], seed, 0.5) if kind == "move" else grow(states[-1], seed))
    return states


@settings(max_examples=40, deadline=None)
@given(moves)
def test_differences_add_up(steps: list[tuple[str, int]]) -> None:
    states = _walk(START, steps)
    walked = states[0]
    for state in states[1:]:
        walked = apply(walked, difference(walked, state))
        assert_same_state(state, walked)
    assert_same_state(states[-1], apply(states[0], difference(states[0], states[-1])))


def test_no_change_is_empty() -> None:
    residual = difference(START, replace(START, version=1))
    assert all(level.is_empty for level in residual.levels)


def test_only_what_changed_is_listed() -> None:
    level = START.levels[1]
    latent, position, alive = level.latent.copy(), level.position.copy(), level.alive.copy()
    latent[7, 3] += 2
    position[9, 0] -= 1
    alive[11] = False
    after = replace(level, latent=latent, position=position, alive=alive)
    residual = difference(START, replace(START, levels=(START.levels[0], after), version=1)).levels[1]
    assert residual.rows.tolist() == [7, 9]
    assert residual.latent[0, 3] == 2
    assert residual.position[1].tolist() == [-1, 0, 0]
    assert residual.removed.tolist() == [11]


def _change(parts: dict[str, Any], scene: Scene = START) -> Scene:
    empty = difference(START, replace(START, version=1))
    whole: dict[str, Any] = {name: getattr(empty.levels[0], name) for name in LevelResidual.__slots__}
    level = LevelResidual(**{**whole, **parts})
    return apply(scene, replace(empty, levels=(level, empty.levels[1])))


@pytest.mark.parametrize("rows", [[-1, 2], [2, 2], [3, 2], [0, 6]])
def test_bad_rows_are_refused(rows: list[int]) -> None:
    with pytest.raises(ValueError, match="ascend"):
        _change({"rows": np.array(rows), "position": np.zeros((2, 3), np.int32), "latent": np.zeros((2, 24), np.int32)})


def test_overflow_is_refused() -> None:
    one = {"rows": np.array([1]), "position": np.zeros((1, 3), np.int32), "latent": np.zeros((1, 24), np.int32)}
    _change({**one, "latent": np.full((1, 24), 32767, np.int32)})
    with pytest.raises(ValueError, match="range"):
        _change({**one, "latent": np.full((1, 24), 32768, np.int32)})
    ones = replace(START.levels[0], position=np.ones_like(START.levels[0].position))
    scene = replace(START, levels=(ones, START.levels[1]))
    with pytest.raises(ValueError, match="range"):
        _change({**one, "position": np.full((1, 3), 2**31 - 1, np.int32)}, scene)


def test_states_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="keyframes"):
        difference(START, replace(START, keyframe=5, version=6))
    with pytest.raises(ValueError, match="fewer rows"):
        difference(grow(START), replace(START, version=2))
    residual = difference(START, move(START))
    with pytest.raises(ValueError, match="does not fit"):
        apply(replace(START, version=1), residual)
