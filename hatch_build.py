"""Build hook: assembles the viewer's WebAssembly kernel from its text, so that no binary is kept in the repository."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = Path("client/web/kernel.wat")


class AssembleKernel(BuildHookInterface):  # type: ignore[type-arg]
    """Writes kernel.wasm next to kernel.wat before files are collected, for wheels and editable installs alike."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Assemble and announce the artefact, which version control ignores."""
        import wasmtime

        source = Path(self.root) / SOURCE
        target = source.with_suffix(".wasm")
        target.write_bytes(wasmtime.wat2wasm(source.read_text()))
        build_data["artifacts"].append(str(SOURCE.with_suffix(".wasm")))
