"""Versions: Python and the packages that streamlod stands on."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

from streamlod.server.doctor.finding import Finding, Verdict

_BASE = ("numpy", "numba", "msgpack", "websockets", "av", "opencv-contrib-python-headless")
_EXTRAS = {
    "train": ("torch", "scikit-learn", "scipy"),
    "serve": ("fastapi", "uvicorn", "pyjwt"),
    "cuda": ("gsplat", "warp-lang"),
}


def check_versions() -> Iterator[Finding]:
    """Python, then the packages of the base install and of each extra."""
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    yield Finding("python", Verdict.OK, f"{platform.python_version()} on {system}")
    yield _packages("packages", _BASE, Verdict.FAULT, "pip install streamlod")
    for extra, names in _EXTRAS.items():
        yield _packages(f"packages [{extra}]", names, Verdict.ABSENT, f"pip install 'streamlod[{extra}]'")


def _packages(check: str, names: tuple[str, ...], missing: Verdict, remedy: str) -> Finding:
    found = {name: _version(name) for name in names}
    text = ", ".join(f"{name} {number or 'missing'}" for name, number in found.items())
    return Finding(check, Verdict.OK, text) if all(found.values()) else Finding(check, missing, text, remedy)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
