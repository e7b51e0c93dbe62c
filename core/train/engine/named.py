"""The engine that a configuration names, and whether it can train it here."""

from __future__ import annotations

import importlib.util

from streamlod.core.errors import BackendUnavailable, InputError
from streamlod.core.render import backends
from streamlod.core.render.backends import Backend
from streamlod.core.train.config import TrainConfig
from streamlod.core.train.later_frame.autograd.engine import autograd_engine
from streamlod.core.train.later_frame.engine import EngineMaker


def named_engine(config: TrainConfig, backend: Backend, device: str) -> EngineMaker:
    """Engines of later frames.

    Args:
        backend: that draws for the usual engine. device: ``cpu`` or ``cuda``.

    Raises:
        InputError: the method has something in it that the engine does not know.
        BackendUnavailable: the engine needs a package that is not installed, or a driver.
    """
    engine, unknown = config.predict.engine, _unknown_to_warp(config)
    if engine == "autograd" or (engine == "auto" and (backend != "warp" or unknown)):
        return autograd_engine(backend)
    if unknown:
        raise InputError("setting predict.engine", f"{unknown}, or set predict.engine=autograd")
    if importlib.util.find_spec("warp") is None:
        raise BackendUnavailable("the engine warp", "install streamlod[cuda], or set predict.engine=autograd")
    if device != "cpu" and (missing := backends.warp_fault()) is not None:
        raise BackendUnavailable("the engine warp", f"{missing}, or set predict.engine=autograd")
    from streamlod.core.train.engine.warp.frame_engine import warp_engine

    return warp_engine(device)


def _unknown_to_warp(config: TrainConfig) -> str:
    """Advice about what the recorded steps do not know; empty where they know everything."""
    if config.model.selection == "distance":
        return "warp draws all levels: set model.selection=all"
    for part in config.parts:
        if part.needs_gradients:
            return f"warp knows no part {part.name}: leave it out"
    return ""
