"""What is compiled ahead of its first use, and training that is rehearsed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from streamlod.codec.coder import change_model, column_model, octree_model, rans, trend
from streamlod.codec.decoder import SceneDecoder
from streamlod.core.errors import InputError
from streamlod.server.pipeline import warming
from streamlod.server.pipeline.rehearsal import rehearse
from tests.codec.scenes import grow, move
from tests.vectors.make import FOLDER, read_stream
from tests.vectors.valid import key, packet, small

ROOT = Path(__file__).parents[3]


MODULES = (change_model, column_model, octree_model, rans, trend)


def signatures() -> dict[str, int]:
    functions = {name: value for module in MODULES for name, value in vars(module).items()}
    return {name: len(value.signatures) for name, value in functions.items() if hasattr(value, "signatures")}


def test_nothing_of_the_codec_is_left_to_compile() -> None:
    warming.WARM_UPS["codec"]()
    before = signatures()
    scene = small()
    packets = [
        key(scene),
        packet(scene, grow(move(scene))),
        *read_stream(FOLDER / "valid-growth-profile1.slps"),
    ]
    decoder = SceneDecoder()
    for data in packets:
        decoder.push(data)
    assert signatures() == before
    assert sum(before.values()) >= 8  # each loop that Python calls


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
