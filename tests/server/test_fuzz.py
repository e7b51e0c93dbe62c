"""Seeds of the server's fuzz targets, and mutants of them, let nothing out but documented errors."""

from __future__ import annotations

import pytest

from tests.fuzz.corpus import mutants
from tests.fuzz.server_targets import SEEDS, TARGETS


@pytest.mark.parametrize("name", list(TARGETS))
def test_whatever_strangers_send_is_taken_or_refused(name: str) -> None:
    seeds = list(SEEDS[name])
    for data in (*seeds, *mutants(seeds, 300, seed=len(name))):
        TARGETS[name](data)
