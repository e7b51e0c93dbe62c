"""Small pictures of what the cameras of a watched rig see, and how they do, for a page, while the rig runs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Any

from streamlod.core.errors import InputError
from streamlod.core.repeating import repeating
from streamlod.server.ingest.recording import WatchedRig
from streamlod.server.ingest.small_jpeg import small_jpeg
from streamlod.server.ingest.sync.picture import Picture

_SECONDS = 0.4  # from one round of pictures to the next


def showing(
    rig: WatchedRig, show: Callable[[dict[str, Any], dict[str, bytes]], object]
) -> AbstractContextManager[None]:
    """Call `show` a few times a second with the rig's statistics and JPEG files by camera while the context lasts."""
    shown: dict[str, Picture] = {}
    pictures: dict[str, bytes] = {}

    def look() -> None:
        for name, picture in dict(rig.newest).items():
            if picture is not shown.get(name):
                shown[name] = picture
                pictures.update(_small(picture))
        show(asdict(rig.statistics()), dict(pictures))

    return repeating(look, _SECONDS, "showing")


def _small(picture: Picture) -> dict[str, bytes]:
    try:
        return {picture.camera: small_jpeg(picture.load())}
    except InputError:  # damaged
        return {}
