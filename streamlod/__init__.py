"""Live free-viewpoint video: level-of-detail Gaussian splatting, trained frame by frame and streamed.

The names below are the public interface (docs/reference/api.md); they keep their meaning within a major version, and
each is loaded when it is first used. `streamlod.core`, `.codec`, `.client` and `.server` are the parts it is made of,
by links to folders of the repository in a checkout and by copies in a wheel; they may change at any time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from streamlod.client.connection.link import WatchOptions
    from streamlod.client.connection.presenting import Presenter
    from streamlod.client.connection.watch import watch
    from streamlod.client.events import Disconnected, NewScene, Notice, Welcome
    from streamlod.client.recorder import open_recorder, write_png
    from streamlod.client.recording import RecordedFrame, RecordingFile, open_recording
    from streamlod.client.rest import ServerClient
    from streamlod.client.viewpoints import camera_named, orbit
    from streamlod.core.camera import Camera
    from streamlod.core.errors import StreamlodError
    from streamlod.core.render.splatter import Splatter
    from streamlod.core.scene.anchors import Scene
    from streamlod.core.version import streamlod_version
    from streamlod.server.pipeline.job import TrainJob
    from streamlod.server.pipeline.offline import TrainingFigures, train_recording

__all__ = [
    "Camera",
    "Disconnected",
    "NewScene",
    "Notice",
    "Presenter",
    "RecordedFrame",
    "RecordingFile",
    "Scene",
    "ServerClient",
    "Splatter",
    "StreamlodError",
    "TrainJob",
    "TrainingFigures",
    "WatchOptions",
    "Welcome",
    "camera_named",
    "open_recorder",
    "open_recording",
    "orbit",
    "streamlod_version",
    "train_recording",
    "watch",
    "write_png",
]

_HOMES = {
    "client.connection.link": ("WatchOptions",),
    "client.connection.presenting": ("Presenter",),
    "client.connection.watch": ("watch",),
    "client.events": ("Disconnected", "NewScene", "Notice", "Welcome"),
    "client.recorder": ("open_recorder", "write_png"),
    "client.recording": ("RecordedFrame", "RecordingFile", "open_recording"),
    "client.rest": ("ServerClient",),
    "client.viewpoints": ("camera_named", "orbit"),
    "core.camera": ("Camera",),
    "core.errors": ("StreamlodError",),
    "core.render.splatter": ("Splatter",),
    "core.scene.anchors": ("Scene",),
    "core.version": ("streamlod_version",),
    "server.pipeline.job": ("TrainJob",),
    "server.pipeline.offline": ("TrainingFigures", "train_recording"),
}
_HOME_OF = {name: f"{__name__}.{module}" for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(_HOME_OF[name]), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
