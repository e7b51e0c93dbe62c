"""What is compiled ahead of its first use, and training that is rehearsed."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.server.pipeline import warming
from streamlod.server.pipeline.rehearsal import rehearse

ROOT = Path(__file__).parents[3]


def test_the_list_has_every_part_that_can_be_warmed() -> None:
    source = inspect.getsource(warming)
    for package in ("core", "codec"):
        for path in (ROOT / package).rglob("warm*.py"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            assert (
                f"from streamlod.{module} import" in source
                or f"from streamlod.{module.rpartition('.')[0]} import warm" in source
            ), module


def test_the_codec_is_warmed() -> None:
    warming.WARM_UPS["codec"]()


@pytest.mark.long
@pytest.mark.timeout(400)
def test_warming_compiles_every_kernel_and_leaves_training_nothing_to_compile() -> None:
    """In a process of its own, so that no other test has compiled anything there."""
    command = [sys.executable, "-m", "tests.server.pipeline.warmed"]
    answer = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, timeout=380)
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found["kernels"] > 100
    assert found["cold"] == [], "have the warm-up of their package call them"
    assert found["late"] == [], "are called with other types than their warm-up uses"


def test_rehearsing_trains_and_refuses_what_training_would() -> None:
    rehearse("live", "cpu")
    with pytest.raises(InputError, match="preset"):
        rehearse("no such preset", "cpu")
