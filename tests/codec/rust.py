"""The decoder in Rust (codec/rust), built and run: what it makes of streams and files, as the manifest says it."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

CRATE = Path(__file__).parents[2] / "codec" / "rust"


@cache
def program() -> Path:
    """The program, compiled once by this process with what is there, from no registry; it goes with the process."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    command = ["cargo", "build", "--release", "--offline", "--quiet"]
    environment = {**os.environ, "CARGO_TARGET_DIR": str(folder)}
    done = subprocess.run(command, cwd=CRATE, env=environment, capture_output=True, text=True, check=False, timeout=500)
    if done.returncode:
        raise AssertionError(done.stderr[-4000:])
    return folder / "release" / "streamlod-decode"


def outcomes(program: Path, streams: Sequence[Sequence[bytes]], scratch: Path) -> list[list[Any]]:
    """Refusal code of the last packet of each stream ("" if accepted), and the state behind it."""
    with scratch.open("wb") as file:
        for packets in streams:
            file.write(struct.pack("<I", len(packets)))
            for packet in packets:
                file.write(struct.pack("<I", len(packet)) + packet)
    found: list[list[Any]] = _run(program, "--batch", scratch)
    return found


def read_file(program: Path, path: Path) -> dict[str, Any]:
    """What the manifest says of a `.slod` file."""
    found: dict[str, Any] = _run(program, path)
    return found


def _run(program: Path, *arguments: str | Path) -> Any:
    done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False, timeout=500)
    if done.returncode:
        raise AssertionError(done.stderr[-2000:])
    return json.loads(done.stdout)
