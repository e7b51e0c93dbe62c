"""Build hook of the viewer page: assembles its WebAssembly kernel from text, and packs its files for wheels."""

from __future__ import annotations

import gzip
import os
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGE = Path("streamlod/client/web")
SHADER = re.compile(r"#version.*?`", re.DOTALL)  # GLSL in a script
CAST = re.compile(r"(?<=[=(,;:?!&|{}\[+-])\(([a-z][\w.#]*(?:\([^()]*\))?)\)(?=[.,;)\]}])")  # what a type was said of
CONSTANTS = re.compile(r"\blet \w+=[^;{}`]*(?:;let \w+=[^;{}`]*)+;")  # declared one after the other
SERVED = {".js", ".css", ".html", ".svg", ".wasm"}


class BuildPage(BuildHookInterface):  # type: ignore[type-arg]
    """Writes kernel.wasm next to kernel.wat, for wheels and editable installs alike; neither it nor what is packed is
    kept in the repository."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before files are collected: make what is missing, and announce it."""
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
        """After the archive is written."""
        if hasattr(self, "packed"):
            self.packed.cleanup()


def pack(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Paths inside `folder` and contents of the page's files without comments, compressed twice: `ui/main.js.br` and
    `ui/main.js.gz`."""
    import brotli  # type: ignore[import-untyped]
    import rjsmin  # type: ignore[import-untyped]

    for path in sorted(path for path in folder.rglob("*") if path.suffix in SERVED):
        content = path.read_bytes()
        if path.suffix == ".js":
            script = rjsmin.jsmin(SHADER.sub(_without_comments, content.decode())).replace("}\n", "}")
            script = re.sub(r"\bconst\b", "let", script)  # shorter; our shaders have no const
            script = re.sub(r"(?<=[=,(*+<>?:&|-])0(?=\.\d)|(?<!\d),(?=\})", "", script)  # 0.5 is .5; last commas
            script = CAST.sub(r"\1", script)
            script = CONSTANTS.sub(lambda several: several[0].replace(";let ", ","), script)
            # semicolons before braces can be left out, except in shaders
            content = re.sub(rf"({SHADER.pattern})|;(?=\}})", r"\1", script, flags=re.DOTALL).encode()
        elif path.suffix == ".css":
            content = re.sub(rb"/\*.*?\*/\s*", b"", content, flags=re.DOTALL)
            content = re.sub(rb"\s*([{};])\s*|([:,])\s+", rb"\1\2", content)
        elif path.suffix == ".html":
            content = re.sub(rb"\n\s+", b"\n", content)
        elif path.suffix == ".wasm":  # its last section: names for debuggers
            content = re.sub(rb"\0[\x80-\xff]?[\0-\x7f]\x04name.*", b"", content, flags=re.DOTALL)
        name = path.relative_to(folder).as_posix()
        tried = (brotli.compress(content, mode, lgwin=window) for mode in range(3) for window in range(10, 19, 2))
        yield f"{name}.br", min(tried, key=len)
        yield f"{name}.gz", gzip.compress(content, mtime=0)


def _without_comments(shader: re.Match[str]) -> str:
    version, _, rest = re.sub(r" *//.*", "", shader[0]).partition("\n")
    return version + "\n" + re.sub(r"\s*([^\w\s$`])\s*", r"\1", rest)
