"""Compiled functions equal the plain ones that they are made of, for any number of rows."""

from __future__ import annotations

import logging
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from core.render import cuda
from core.render.compiling import Compiled
from core.train.field import decode, exposure
from core.train.keyframe import random_background
from core.train.optimise import losses, penalty, rate
from core.train.residual import apply, groups

SLOTS = 2
Given = Callable[[int], tuple[object, ...]]


def _splats(count: int) -> list[Tensor]:
    return [torch.randn(count, width) for width in (3, 4, 3)] + [torch.randn(count), torch.randn(count, 3)]


def _anchors(count: int) -> tuple[Tensor, ...]:
    return torch.randn(count, SLOTS, 3), torch.randn(count, 6)


def _planes(*more: int, rows: int) -> Tensor:
    return torch.rand(*more, rows, 7)


def _changes(count: int) -> tuple[Tensor, Tensor]:
    return 2 * torch.randn(count, 24), 2 * torch.randn(count, 3)


CASES: dict[str, tuple[Compiled, Given]] = {
    "activated": (decode._ACTIVATED, lambda n: (torch.randn(n, 11 * SLOTS), *_anchors(n), torch.randn(n, 3))),
    "differentiated": (
        decode._DIFFERENTIATED,
        lambda n: (*_anchors(n), *_splats(SLOTS * n)[2:], *_splats(SLOTS * n)),
    ),
    "held": (cuda._HELD, lambda n: (*_splats(n), torch.eye(4), torch.eye(3), torch.zeros(3), torch.ones(2))),
    "of sound": (cuda._OF_SOUND, lambda n: (torch.rand(n) > 0.5, n // 2, *_splats(n))),
    "moments": (losses._MOMENTS, lambda n: (torch.rand(n, 7, 3), torch.rand(n, 7, 3))),
    "similarity": (
        losses._SIMILARITY,
        lambda n: (_planes(5, 3, rows=n), torch.rand(n, 7, 3), torch.rand(n, 7, 3), 0.2, None, None),
    ),
    "slope": (
        losses._SLOPE,
        lambda n: (torch.rand(n, 7, 3), torch.rand(n, 7, 3), _planes(3, 3, rows=n), None, None, 0.2),
    ),
    "weighted slope": (
        losses._SLOPE,
        lambda n: (*torch.rand(2, n, 7, 3), _planes(3, 3, rows=n), None, torch.rand(n, 7, 3), 0.2),
    ),
    "penalty": (penalty._PRICED, lambda n: (*_splats(n)[2:4], torch.tensor(n // 2), 0.1, 0.2)),
    "at camera": (exposure._AT_CAMERA, lambda n: (torch.rand(3), torch.rand(3), n // 2, n)),
    "over colour": (
        random_background._OVER,
        lambda n: (torch.rand(n, 7, 3), torch.rand(n, 7), torch.rand(n, 7, 3) / 8, torch.rand(3)),
    ),
    "pulled": (
        random_background._PULLED,
        lambda n: (torch.rand(n, 7, 3) / 8, torch.rand(3), torch.randn(n, 7, 3)),
    ),
    "row sums": (rate._ROW_SUMS, _changes),
    "price of a residual": (
        rate._PRICED,
        lambda n: (*_changes(n), torch.rand(n), torch.rand(n), *torch.rand(2), rate._table(torch.device("cpu"))),
    ),
    "integers": (apply._INTEGERS, _changes),
    "moved": (
        groups._MOVED,
        lambda n: (torch.rand(n, 3), torch.rand(9, 3), torch.rand(9, 3), torch.randint(0, 9, (n,)), torch.rand(n, 3)),
    ),
    "pulled by groups": (groups._PULLED, lambda n: (torch.rand(n, 3), torch.rand(n, 3))),
}


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning:torch")
@pytest.mark.parametrize(
    "backend", ["eager", *(pytest.param(name, marks=pytest.mark.slow) for name in ("aot_eager", "inductor"))]
)
@pytest.mark.parametrize("name", CASES)
def test_compiled_for_any_number_of_rows_it_equals_the_function(name: str, backend: str) -> None:
    plain, given = CASES[name]
    compiled = Compiled(plain.function, backend, "cpu")
    with torch.no_grad():
        for count in (40, 71, 53):
            arguments = given(count)
            torch.testing.assert_close(compiled(*arguments), plain.function(*arguments), rtol=1e-4, atol=1e-5)
    assert compiled._ready is not plain.function


def test_every_compiled_function_is_compared() -> None:
    modules = (random_background, decode, cuda, losses, penalty, exposure, rate, apply, groups)
    compiled = {value.function for module in modules for value in vars(module).values() if isinstance(value, Compiled)}
    assert compiled == {plain.function for plain, _ in CASES.values()}


def test_where_compiling_fails_one_sentence_says_so(caplog: pytest.LogCaptureFixture) -> None:
    def refuses(*_: object) -> None:
        raise RuntimeError("no compiler\nand a long story")

    function = rate._row_sums
    compiled, given = Compiled(function, refuses, "cpu"), _changes(9)  # type: ignore[arg-type]
    with caplog.at_level(logging.WARNING):
        found = [compiled(*given) for _ in range(2)][-1]
    (record,) = caplog.records
    assert "_row_sums is not compiled and so runs slower" in record.message
    assert "\n" not in record.message
    assert all(torch.equal(mine, wanted) for mine, wanted in zip(found, function(*given), strict=True))
