"""`python -m tests.fuzz.run_server TARGET [libFuzzer options]`: atheris on what strangers send to the server."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path


def main() -> None:
    """Run one target until it fails or the options say stop."""
    import atheris  # type: ignore[import-not-found, import-untyped, unused-ignore]

    include = [
        *(
            "streamlod.server.protocol.messages",
            "streamlod.server.protocol.thin_messages",
            "streamlod.server.auth.gate",
            "streamlod.server.auth.keys",
        ),
        *(
            "streamlod.server.auth.links",
            "streamlod.server.settings",
            "streamlod.server.pipeline.spec",
            "streamlod.server.pipeline.job",
        ),
        *("streamlod.server.ingest.cameras.definition", "streamlod.server.api.ranges", "json", "jwt"),
    ]
    with atheris.instrument_imports(include=include):
        from tests.fuzz.server_targets import SEEDS, TARGETS

    name = sys.argv.pop(1)
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(SEEDS[name]):
            (Path(folder) / str(number)).write_bytes(seed)
        atheris.Setup([*sys.argv, folder], TARGETS[name])
        atheris.Fuzz()


if __name__ == "__main__":
    main()
