"""`python -m tests.fuzz.run TARGET [libFuzzer options]`: fuzz with atheris, starting from the vectors."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.fuzz.corpus import SEEDS
from tests.fuzz.targets import TARGETS, repair


def main() -> None:
    """Run one target until it fails or the options say stop."""
    import atheris  # type: ignore[import-not-found, import-untyped, unused-ignore]

    name = sys.argv.pop(1)

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        mutated: bytes = atheris.Mutate(data, most)
        return repair(mutated)[:most]

    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(SEEDS[name]()):
            (Path(folder) / str(number)).write_bytes(seed)
        atheris.instrument_all()
        options = {"custom_mutator": mutate} if name == "packet" else {}
        atheris.Setup([*sys.argv, folder], TARGETS[name], **options)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
