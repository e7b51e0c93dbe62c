"""The sound of a rig on its way from a source to viewers: resampled, without gaps, in pieces of Opus."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from fractions import Fraction

import av

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.sound.encoder import SoundEncoder
from streamlod.codec.sound.opus import SAMPLE_RATE
from streamlod.codec.sound.packets import OpusPacket
from streamlod.core.data.video.sound import Placer, audible
from streamlod.core.errors import InputError
from streamlod.server.ingest.sync.timeline import Timeline

_LOG = logging.getLogger(__name__)
_PIECE_PACKETS = 10  # 200 ms: pictures are older than that before anybody sees them
_NEVER_NS = 2**63
_DEAD_NS = 10_000_000_000  # without a sound, after which it is worth a word


class Hearing:
    """Takes the sound of one source from a thread, and gives it on in pieces.

    Args:
        source: name of the camera, microphone or file.
        give: takes each piece.
        timeline: the rig's.
        wait: called with the time of sound that is to be given on; waits where that is too early.
        offset_ns: nanoseconds that are added to the times of the sound, as to those of its camera's pictures.

    Attributes:
        reached_ns: time of the newest sound that came; later than any once none comes.
    """

    def __init__(
        self,
        source: str,
        give: Callable[[SoundPiece], None],
        timeline: Timeline,
        wait: Callable[[int], None],
        offset_ns: int,
    ) -> None:
        self.source = source
        self._give, self._timeline, self._wait, self._offset_ns = give, timeline, wait, offset_ns
        self._lock = threading.Lock()
        self._placer: Placer | None = None
        self._encoder: SoundEncoder | None = None
        self._waiting: list[OpusPacket] = []
        self._came_ns = self._loud_ns = timeline.now_ns()
        self._reason = ""
        self._told = ""
        self.reached_ns = 0

    def put(self, frame: av.AudioFrame, capture_ns: int) -> None:
        """Sound has come, whose first sample was recorded at `capture_ns`."""
        capture_ns += self._offset_ns
        self.reached_ns = capture_ns
        self._wait(capture_ns)
        with self._lock:
            try:
                pieces = self._pieces(frame, Fraction(capture_ns, 1_000_000_000))
            except (InputError, av.FFmpegError, ValueError) as error:
                self._reason = getattr(error, "fault", None) or str(error)
                return
            self._came_ns, self._reason = self._timeline.now_ns(), ""
        for piece in pieces:
            self._give(piece)

    def gone(self, reason: str) -> None:
        """The source gives no sound for now."""
        with self._lock:
            self._reason = reason
        self.reached_ns = _NEVER_NS
        self._wait(0)  # for nothing; pictures may wait for this

    def fault(self) -> str:
        """Why nothing is heard, in a sentence; empty where there is sound."""
        now = self._timeline.now_ns()
        with self._lock:
            reason = self._reason
            if not reason and now - self._came_ns > _DEAD_NS:
                reason = "it sends none"
            elif not reason and now - self._loud_ns > _DEAD_NS:
                reason = "it sends silence; is it muted, or has it no power?"
        fault = f"no sound of {self.source}: {reason}" if reason else ""
        if fault != self._told:
            self._told = fault
            _LOG.warning("%s", fault or f"sound of {self.source} is heard again")
        return fault

    def _pieces(self, frame: av.AudioFrame, time: Fraction) -> list[SoundPiece]:
        if self._placer is None or self._encoder is None:
            channels = min(max(frame.layout.nb_channels, 1), 2)
            self._placer, self._encoder = Placer(SAMPLE_RATE, channels), SoundEncoder(channels)
        done: list[SoundPiece] = []
        for begin, block in self._placer.put(frame, time):
            if audible(block).any():
                self._loud_ns = self._timeline.now_ns()
            for packet in self._encoder.put(block, begin):
                last = self._waiting[-1] if self._waiting else packet
                if len(self._waiting) == _PIECE_PACKETS or last.time + last.samples < packet.time:
                    done.append(SoundPiece(self._encoder.settings, tuple(self._waiting)))
                    self._waiting.clear()
                self._waiting.append(packet)
        return done
