"""`python -m tests.fuzz.run TARGET [libFuzzer options]`: fuzz with atheris, from the vectors on.

Only Python code is instrumented; the compiled loops count as one step. With NUMBA_BOUNDSCHECK=1 they check indices.
"""

from __future__ import annotations

import sys
import tempfile
from importlib import import_module
from pathlib import Path


def main() -> None:
    """Run one target until it fails or the options say stop."""
    import atheris  # type: ignore[import-not-found, import-untyped, unused-ignore]

    for compiled in ("change_model", "class_model", "octree_model", "trend"):
        import_module(f"streamlod.codec.coder.{compiled}")  # before, so that they stay as they are
    with atheris.instrument_imports(
        include=[
            "streamlod.codec",
            "streamlod.core",
            "streamlod.client.playback",
            "streamlod.server.protocol.messages",
            "streamlod.server.protocol.thin_messages",
        ]
    ):
        from tests.fuzz.corpus import SEEDS
        from tests.fuzz.targets import REPAIRS, TARGETS

    name = sys.argv.pop(1)

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        mutated: bytes = atheris.Mutate(data, most)
        return REPAIRS[name](mutated)[:most]

    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(SEEDS[name]()):
            (Path(folder) / str(number)).write_bytes(seed)
        options = {"custom_mutator": mutate} if name in REPAIRS else {}
        atheris.Setup([*sys.argv, folder], TARGETS[name], **options)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
