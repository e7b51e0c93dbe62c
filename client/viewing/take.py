"""A recording in progress: what a viewpoint sees of the states of a stream, in a film or a folder of pictures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from streamlod.client.events import NewScene
from streamlod.client.recorder import Recorder, is_film, open_recorder
from streamlod.client.viewpoints import CameraPath
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.gaps import MAX_GAP_SECONDS
from streamlod.core.render.splatter import Splatter, draw_cloud, shown_at
from streamlod.core.scene.anchors import SceneHeader
from streamlod.core.scene.interpolate import can_interpolate, interpolate

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class _Opened:
    """A take from its first state on.

    Attributes:
        path: of the camera.
        recorder: takes the pictures.
        stream_fps, fps: frames a second of the stream, pictures a second of the recording.
    """

    path: CameraPath
    recorder: Recorder
    stream_fps: float
    fps: float


class Take:
    """Pictures of a stream's states, and of what lies between them, at the recording's rate.

    Args:
        out: the file or folder.
        viewpoint: makes the path of the camera once the scene's header is known.
        frames: pictures that are wanted; None for all there are.
        fps: pictures a second of the recording; those of the stream by default.
        tell: called with short texts about the progress.

    Attributes:
        newest: the state that was drawn last.
        count: pictures so far.
        filmed_ns: when each of them was filmed; None once the stream is over.
        fps: pictures a second of the recording; 0 before the first one, where the stream's own are taken.
    """

    def __init__(
        self,
        out: Path,
        viewpoint: Callable[[SceneHeader], CameraPath],
        frames: int | None,
        fps: float | None,
        tell: Tell,
    ) -> None:
        self._out, self._viewpoint, self._frames, self._tell = out, viewpoint, frames, tell
        self._splatter = Splatter()
        self._opened: _Opened | None = None
        self._place = -1  # of the newest state in the stream, in frames
        self._keeps_time = fps is not None or is_film(out)
        self.newest: NewScene | None = None
        self.count = 0
        self.filmed_ns: list[int | None] = []
        self.fps = fps or 0.0

    @property
    def is_full(self) -> bool:
        """Whether there are as many pictures as are wanted."""
        return self._frames is not None and self.count >= self._frames

    def moves(self) -> bool:
        """Whether the next picture would be taken from another viewpoint than the last one."""
        if self._opened is None:
            return False
        before, after = self._opened.path(self.count - 1), self._opened.path(self.count)
        return bool((before.world_to_camera != after.world_to_camera).any())

    async def draw(self, event: NewScene) -> None:
        """Draw the pictures after the state before, up to and with the moment of this one."""
        is_over = event is self.newest
        before, self.newest = self.newest or event, event
        opened = self._opened = self._opened or self._open(event.scene.header)
        step = self._frames_between(before, event, opened.stream_fps)
        self._place += step
        while not self.is_full and (place := self.count * opened.stream_fps / opened.fps) <= self._place:
            share = 1 + (place - self._place) / step
            opened.recorder.add(await asyncio.to_thread(self._picture, before, event, share, opened.path(self.count)))
            self.filmed_ns.append(None if is_over else _filmed_ns(before, event, share))
            self.count += 1
            self._tell(f"picture {self.count}, version {event.scene.version}")

    def close(self, error: BaseException | None) -> None:
        """Complete the recording, or discard it after an error."""
        if self._opened is not None:
            self._opened.recorder.__exit__(None if error is None else type(error), error, None)

    def _open(self, header: SceneHeader) -> _Opened:
        path = self._viewpoint(header)
        self.fps = self.fps or header.fps
        recorder = open_recorder(self._out, self.fps)
        recorder.__enter__()
        return _Opened(path, recorder, header.fps, self.fps)

    def _frames_between(self, before: NewScene, after: NewScene, stream_fps: float) -> int:
        """Frames of the stream from one state to the next: more than one where training could not keep up."""
        seconds = (after.info.time_ns - before.info.time_ns) / 1e9
        return max(1, round(min(seconds, MAX_GAP_SECONDS) * stream_fps)) if self._keeps_time else 1

    def _picture(self, before: NewScene, after: NewScene, share: float, camera: Camera) -> UInt8:
        """[H,W,3] uint8 RGB, `share` of the way from one state to the next."""
        if share >= 1 or before is after:
            return self._splatter.picture(after.scene, camera, after.levels)
        if not can_interpolate(before.scene, after.scene):
            return self._splatter.picture(before.scene, camera, before.levels)
        cloud = interpolate(before.scene, after.scene, share, camera.centre, after.levels - 1)
        return draw_cloud(cloud, camera, after.scene.header.background, shown_at(after.scene, camera))


def _filmed_ns(before: NewScene, after: NewScene, share: float) -> int:
    """When a picture was filmed that lies `share` of the way from one state to the next."""
    begin, end = before.info.time_ns, after.info.time_ns
    return end if end < begin else round(begin + share * (end - begin))  # a recording that begins again
