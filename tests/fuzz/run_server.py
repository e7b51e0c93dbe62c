"""`python -m tests.fuzz.run_server TARGET [libFuzzer options]`: atheris on what strangers send to the server."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path


def main() -> None:
    """Run one target until it fails or the options say stop."""
    import atheris  # type: ignore[import-not-found, import-untyped, unused-ignore]

    include = [
        *("server.protocol.messages", "server.protocol.thin_messages", "server.auth.gate", "server.auth.keys"),
        *("server.auth.links", "server.settings", "server.pipeline.spec", "server.pipeline.job"),
        *("server.ingest.cameras.definition", "server.api.ranges", "json", "jwt"),
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
