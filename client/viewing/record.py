"""Watch a live stream and record what a viewpoint sees of it, at the stream's rate or another."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import aclosing
from pathlib import Path

from streamlod.client.connection.address import live_address
from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.watch import watch
from streamlod.client.events import Event, NewScene, Notice, Welcome
from streamlod.client.recorder import is_film
from streamlod.client.viewing.film_sound import fetch_and_add
from streamlod.client.viewing.take import Take, Tell
from streamlod.client.viewpoints import CameraPath
from streamlod.core.errors import FilmCutShort, InputError, SessionError
from streamlod.core.scene.anchors import SceneHeader

_LOG = logging.getLogger(__name__)
_WHOLE_SECONDS = 10.0  # that the first picture may wait for all levels of its scene
_QUIET_SECONDS = 2.0  # a stream that has ended is over when no packet comes for so long
_GONE_SECONDS = 30.0  # that a film of what a server has kept waits for more, where none may come
_WITHOUT_PICTURES = ("idle", "starting", "degraded")  # states of a stream in which no picture may ever come


async def record_stream(
    url: str,
    out: Path,
    viewpoint: Callable[[SceneHeader], CameraPath],
    frames: int | None = None,
    options: WatchOptions | None = None,
    tell: Tell = lambda text: None,
    fps: float | None = None,
) -> int:
    """Record each state that arrives as one frame of the stream, until there are `frames` pictures or it is over.

    It begins with the newest state as soon as all levels of it are here, which come one after the other after an older
    keyframe, or after ten seconds.

    A folder at the stream's own rate has one picture for each state. A film, and a folder at another rate, last as long
    as what they show, but for gaps of more than ten seconds: pictures that fall between two states show what lies
    between them (`core.scene.interpolate`), or the earlier one where a keyframe comes between.

    Begun in the past (`options.start`), it is over, too, when all of that is here, the stream lacks cameras or is idle,
    and half a minute brings nothing new.

    If the viewpoint moves, it finishes its path around the last scene when the stream is over. Where this is cancelled,
    as by Ctrl-C, what was recorded until then is kept, with its sound.

    Args:
        viewpoint: makes the path of the camera once the scene's header is known.
        tell: called with short texts about the progress.
        fps: pictures a second of the recording; those of the stream by default.

    Returns:
        Number of pictures.

    Raises:
        InputError: no server answers, the viewpoint does not exist, the disk is full, or nothing could be recorded.
        SessionError: the server refuses us or breaks the protocol.
        FilmCutShort: either of them after the first picture; the recording is whole and holds those before it.
    """
    options = options or WatchOptions()
    take = Take(out, viewpoint, frames, fps, tell)
    reception = _Reception(take, options, tell)
    cut: BaseException | None = None
    try:
        async with aclosing(watch(url, options)) as events:
            while not take.is_full:
                try:
                    async with asyncio.timeout(reception.patience):
                        event = await anext(events)
                except TimeoutError:
                    reception.explain_end()
                    break
                except StopAsyncIteration:
                    break
                await reception.handle(event)
        await reception.draw_kept()
        while take.newest is not None and frames is not None and not take.is_full and take.moves():
            await take.draw(take.newest)
    except BaseException as error:
        is_stopped = isinstance(error, KeyboardInterrupt | asyncio.CancelledError)  # the usual end of live ones
        if take.count == 0 or not (is_stopped or isinstance(error, InputError | SessionError)):
            take.close(error)
            raise
        cut = error if is_stopped else FilmCutShort(out, str(error), take.count)
        cut.__cause__ = None if is_stopped else error
    take.close(None)
    if take.count == 0:
        raise InputError(url, "the stream ended before it had a picture")
    if reception.has_sound and is_film(out):
        tell("adding its sound")  # after Ctrl-C, too, where nobody should think that it hangs and press it again
        await asyncio.to_thread(fetch_and_add, live_address(url), options.token, out, take.filmed_ns, take.fps)
    if cut is not None:
        raise cut
    return take.count


class _Reception:
    """Listens to a stream, and puts those of its states into the take that belong there.

    Attributes:
        has_sound: whether there is sound to add to a film.
    """

    def __init__(self, take: Take, options: WatchOptions, tell: Tell) -> None:
        self._take, self._tell = take, tell
        self._levels = options.levels  # asked for; None for all
        self._is_of_the_past = options.start is not None
        self._kept: NewScene | None = None  # the newest state before the first picture
        self._is_there = self._is_of_the_past  # at the live edge, or where it is to begin
        self._begin_by = float("inf")
        self._state = self._detail = ""  # of the stream, in the server's words
        self._caught_up: float | None = None  # since when nothing new has come to what the server has kept
        self.has_sound = False

    @property
    def patience(self) -> float | None:
        """Seconds that the next event is waited for; None without end."""
        if self._state == "ended" and (self._take.newest or self._kept) is not None:
            return _QUIET_SECONDS
        if self._caught_up is not None and self._state in _WITHOUT_PICTURES:
            return max(0.0, self._caught_up + _GONE_SECONDS - time.monotonic())
        return None

    def explain_end(self) -> None:
        """Say why it is over where the stream is not."""
        if self._state != "ended":
            why = f"{self._state}: {self._detail}" if self._detail else self._state
            _LOG.warning("the stream is %s; nothing new came for %.0f s, so it ends here", why, _GONE_SECONDS)

    async def handle(self, event: Event) -> None:
        """Draw a new scene; report other events."""
        if isinstance(event, NewScene):
            if not self._kept_back(event):
                await self._take.draw(event)
            self._caught_up = None if self._caught_up is None else time.monotonic()
        elif isinstance(event, Welcome):
            self.has_sound = event.has_sound
            self._enter(event.state)
        elif isinstance(event, Notice) and event.name == "state":
            self._enter(str(event.fields.get("state")), str(event.fields.get("detail", "")))
            if self._state == "failed":
                raise InputError("stream", f"has failed: {self._detail}")
        elif isinstance(event, Notice) and event.name == "caught_up":
            self._caught_up = time.monotonic() if self._is_of_the_past else None
            self._is_there = True
            if self._kept is not None and not self._kept_back(self._kept):
                await self.draw_kept()
        elif isinstance(event, Notice) and event.name == "sound":
            self.has_sound = True
        elif isinstance(event, Notice) and event.name == "progress":
            self._tell(f"first frame {100 * float(event.fields.get('fraction') or 0):.0f} %")

    async def draw_kept(self) -> None:
        """Draw what is here of a stream, if nothing of it was drawn so far."""
        if self._take.newest is None and self._kept is not None:
            await self._take.draw(self._kept)

    def _enter(self, state: str, detail: str = "") -> None:
        """The stream is in that state now."""
        self._state, self._detail = state, detail
        self._tell(f"stream is {state}{detail and ': '}{detail}")

    def _kept_back(self, event: NewScene) -> bool:
        """Keep a first state that newer ones or more of its levels follow soon; whether it was kept."""
        count = len(event.scene.levels)
        now = time.monotonic()
        is_whole = self._is_there and event.levels >= min(count, self._levels or count)
        if self._take.count > 0 or is_whole or now > self._begin_by:
            return False
        self._begin_by = min(self._begin_by, now + _WHOLE_SECONDS)
        self._kept = event
        return True
