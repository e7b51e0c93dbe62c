"""Bars of long work, for people at a terminal and for logs."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, TypeAlias

from tqdm import tqdm

Bar: TypeAlias = "tqdm[Any]"
_TERMINAL_SECONDS, _LOG_SECONDS = 0.1, 10.0  # between two drawings


def progress_bar(work: Iterable[Any] | None = None, **options: Any) -> Bar:
    """A bar on standard error, of `work` or to be updated by hand; drawn seldom where that is no terminal.

    Args:
        options: of tqdm, such as `total`, `unit` and `desc`.
    """
    seconds = _TERMINAL_SECONDS if sys.stderr.isatty() else _LOG_SECONDS
    return tqdm(work, mininterval=seconds, **options)
