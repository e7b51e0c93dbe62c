"""The one way in which this package compiles: Numba, cached on disk, no parallel threads, exact integers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """`function` as machine code, compiled at its first call."""
    return cast(F, njit(cache=True)(function))
