"""Values of options that several commands check or combine: settings, and paths that exist."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamlod.core.errors import InputError

if TYPE_CHECKING:
    from streamlod.server.settings import Settings


def chosen_settings(config: Path | None, **given: Any) -> Settings:
    """The settings of a file, if there is one, with the options that were given in place of its own."""
    from streamlod.server.settings import Settings, load_settings

    loaded = {} if config is None else load_settings(config).model_dump()
    chosen = {name: value for name, value in given.items() if value is not None}
    if isinstance(chosen.get("edge"), dict):  # the rest of the file's table stays
        chosen["edge"] = (loaded.get("edge") or {}) | chosen["edge"]
    return Settings(**loaded | chosen)


def require(path: Path) -> None:
    """Refuse a path that is not there, before anything heavy is loaded."""
    if not path.exists():
        raise InputError(path, "does not exist")
