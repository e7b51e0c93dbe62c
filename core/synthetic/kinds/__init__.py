"""The kinds of synthetic places, by name. Each module of this package is one kind and defines its `KIND`."""

from __future__ import annotations

import importlib
import pkgutil

from streamlod.core.synthetic.kind import Kind

KINDS: dict[str, Kind] = {
    module.name: importlib.import_module(f"{__name__}.{module.name}").KIND for module in pkgutil.iter_modules(__path__)
}
