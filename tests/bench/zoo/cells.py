"""Results of the zoo on disk: one line of JSON a cell, appended when it is measured, so that a run can go on later."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError

_log = logging.getLogger(__name__)
SCHEMA = 4
_PACKAGES = ("core", "codec", "client/evaluation", "tests/bench/zoo")  # whose source affects a cell's figures


def program_digest() -> str:
    """Digest of the source that measures; cells measured under different digests are not mixed."""
    root, digest = Path(__file__).parents[3], hashlib.sha256()
    for path in sorted(path for package in _PACKAGES for path in (root / package).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class CellKey:
    """The identity of a cell.

    Attributes:
        scene: of the zoo. views: training cameras. seed: of the training.
        system: ``ours``, ``plain`` or ``paper``. preset: of ``ours``; plain Gaussians get the CPU time that it took.
        downscale: how many times smaller pictures are than the scene's nominal size.
        frames: measured, the first one included.
        points: the way to first points, the same for all systems.
    """

    scene: str
    views: int
    seed: int
    system: str
    preset: str
    downscale: float
    frames: int
    points: str


class Cells:
    """The cells of one file, all measured by one program.

    Args:
        path: of the file; it need not be there.
        program: the digest of this one.

    Raises:
        InputError: the file holds something else, or another program measured it.
    """

    def __init__(self, path: Path, program: str) -> None:
        self._path, self._program = path, program
        self._known: dict[CellKey, dict[str, Any]] = {}
        if path.is_file():
            self._read()

    def __contains__(self, key: CellKey) -> bool:
        return key in self._known

    def get(self, key: CellKey) -> dict[str, Any] | None:
        """The figures of a cell, None where it was not measured."""
        return self._known.get(key)

    def items(self) -> list[tuple[CellKey, dict[str, Any]]]:
        """All cells, in the order in which they were measured."""
        return list(self._known.items())

    def add(self, key: CellKey, figures: dict[str, Any]) -> None:
        """Append a cell; one write, so that a run that is stopped leaves whole lines."""
        value = {"schema": SCHEMA, "program": self._program, "key": asdict(key), "figures": figures}
        line = json.dumps(value, allow_nan=False) + "\n"
        try:
            descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                os.write(descriptor, line.encode())
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise InputError(self._path, f"cannot be written ({error.strerror})") from error
        self._known[key] = figures

    def _read(self) -> None:
        data = self._path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            _log.warning("%s: the last line is incomplete and is measured again", self._path)
            os.truncate(self._path, whole)
        for number, line in enumerate(data[:whole].decode("utf-8", "replace").splitlines(), 1):
            try:
                value = json.loads(line)
                schema, program = value["schema"], value.get("program")
                key, figures = CellKey(**value["key"]), dict(value["figures"])
            except (ValueError, TypeError, KeyError) as error:
                raise InputError(self._path, f"line {number} is no cell of the zoo; name another folder") from error
            if schema != SCHEMA:
                raise InputError(self._path, f"line {number} has another schema; name another folder")
            if program != self._program:
                raise InputError(self._path, f"line {number} was measured by another program; name another folder")
            self._known[key] = figures
