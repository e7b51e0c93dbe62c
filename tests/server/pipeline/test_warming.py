"""What is compiled ahead of its first use, and training that is rehearsed."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

from core.errors import InputError
from server.pipeline import warming
from server.pipeline.rehearsal import rehearse

ROOT = Path(__file__).parents[3]


def test_the_list_has_every_part_that_can_be_warmed() -> None:
    source = inspect.getsource(warming)
    for package in ("core", "codec"):
        for path in (ROOT / package).rglob("warm*.py"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            assert f"from {module} import" in source or f"from {module.rpartition('.')[0]} import warm" in source, (
                module
            )


def test_the_codec_is_warmed() -> None:
    warming.WARM_UPS["codec"]()


def test_rehearsing_trains_and_refuses_what_training_would() -> None:
    rehearse("live", "cpu")
    with pytest.raises(InputError, match="preset"):
        rehearse("no such preset", "cpu")
