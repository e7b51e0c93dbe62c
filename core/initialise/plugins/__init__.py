"""Ways to first points that need a package which streamlod does not install; each is loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module

from streamlod.core.initialise.method import Method

PLUGINS = {"vggt": "vggt", "depth-anything": "depth_anything"}
"""name -> module of this package whose constant ``METHOD`` is the method."""


def load(name: str) -> Method:
    """The method of `PLUGINS` that has this name."""
    method: Method = import_module(f"{__name__}.{PLUGINS[name]}").METHOD
    return method
