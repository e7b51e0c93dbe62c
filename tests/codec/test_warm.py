"""After `warm_up`, coding compiles nothing more."""

from __future__ import annotations

from streamlod.codec.coder import change_model, column_model, octree_model, rans, trend
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.warm import warm_up
from tests.codec.scenes import grow, move
from tests.vectors.make import FOLDER, read_stream
from tests.vectors.valid import key, packet, small

MODULES = (change_model, column_model, octree_model, rans, trend)


def _signatures() -> dict[str, int]:
    functions = {name: value for module in MODULES for name, value in vars(module).items()}
    return {name: len(value.signatures) for name, value in functions.items() if hasattr(value, "signatures")}


def test_nothing_is_left_to_compile() -> None:
    warm_up()
    before = _signatures()
    scene = small()
    packets = [
        key(scene),
        packet(scene, grow(move(scene))),
        *read_stream(FOLDER / "valid-growth-profile1.slps"),
    ]
    decoder = SceneDecoder()
    for data in packets:
        decoder.push(data)
    assert _signatures() == before
    assert sum(before.values()) >= 8  # each loop that Python calls
