"""Build hook of the viewer page: assembles its WebAssembly kernel from text, and compresses its files for wheels."""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGE = Path("streamlod/client/web")
SERVED = {".js", ".css", ".html", ".svg", ".wasm", ".wgsl"}


class BuildPage(BuildHookInterface):  # type: ignore[type-arg]
    """Writes kernel.wasm next to kernel.wat, for wheels and editable installs alike.

    Neither it nor the compressed files are kept in the repository.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make what is missing before files are collected, and announce it."""
        import wasmtime

        page = Path(self.root) / PAGE
        source = page / "decode" / "kernel.wat"
        target = source.with_suffix(".wasm")
        assembled = wasmtime.wat2wasm(source.read_text())
        if not target.exists() or target.read_bytes() != assembled:
            beside = target.with_name(f"kernel-{os.getpid()}")  # without a suffix, so that nobody serves or packs it
            beside.write_bytes(assembled)
            beside.replace(target)  # whole at once: other processes may be reading it
        build_data["artifacts"].append(f"{PAGE}/decode/{target.name}")
        if self.target_name != "wheel" or version != "standard":
            return
        self.packed = TemporaryDirectory()
        for name, content in pack(page):
            place = Path(self.packed.name) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
            build_data["force_include"][str(place)] = f"{PAGE}/{name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compressed files after the archive is written."""
        if hasattr(self, "packed"):
            self.packed.cleanup()


def pack(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Paths inside `folder` and contents of the page's files, compressed twice: `ui/main.js.br` and `ui/main.js.gz`.

    Scripts stay as they are written, so that what a browser shows can be read and debugged.
    """
    import brotli  # type: ignore[import-untyped]

    for path in sorted(path for path in folder.rglob("*") if path.suffix in SERVED):
        name, content = path.relative_to(folder).as_posix(), path.read_bytes()
        yield f"{name}.br", brotli.compress(content)
        yield f"{name}.gz", gzip.compress(content, mtime=0)
