"""The ways to first points, one module each: its constant ``METHODS`` names those that it offers."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from streamlod.core.initialise.method import Method


def known_methods() -> dict[str, Method]:
    """Every method by its name, from all modules of this package."""
    found: dict[str, Method] = {}
    for module in iter_modules(__path__):
        found |= import_module(f"{__name__}.{module.name}").METHODS
    return found
