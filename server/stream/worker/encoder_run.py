"""How far the encoder of a stream has come: in which epoch it is, and after which frame training would continue."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from streamlod.server.protocol.packets import Position
from streamlod.server.stream.recording.stored_stream import StoredStream


@dataclass(frozen=True, slots=True)
class EncoderRun:
    """The run of an encoder that made a stream's newest packet.

    Attributes:
        epoch: its number; 0 before the first packet.
        is_over: whether the next packet begins another run.
        frames: of the source that are trained; the next worker continues after them.
        trained_from: names what they are trained from; empty where no worker continues, as with a file that is played.
    """

    epoch: int = 0
    is_over: bool = True
    frames: int = 0
    trained_from: str = ""

    @property
    def next_epoch(self) -> int:
        """The epoch of the packet that comes next."""
        return self.epoch + self.is_over

    def begun(self) -> EncoderRun:
        """The run whose first packet has come."""
        return replace(self, epoch=self.next_epoch, is_over=False)

    def ended(self) -> EncoderRun:
        """This run, after which the next worker's begins."""
        return replace(self, is_over=True)

    def anew(self) -> EncoderRun:
        """This run, after which another one begins with the source's first frame."""
        return replace(self, is_over=True, frames=0)

    def reported(self, report: dict[str, Any] | None) -> EncoderRun:
        """This run after a frame of which a worker reports, or with nothing to continue, where it reports none."""
        return replace(self, frames=report.get("done", self.frames + 1) if report else 0)

    def resumed(self, stored: StoredStream, newest: Position) -> EncoderRun:
        """This run with the frames up to a recording's newest state, if they were trained from the same."""
        is_same = bool(self.trained_from) and stored.trained_from == self.trained_from
        if not is_same or newest.epoch != stored.epoch:
            return self
        return replace(self, frames=max(0, newest.version + 1 - stored.lead))

    def note(self, version: int) -> dict[str, Any]:
        """Fields of `StoredStream` by which training can continue, when the newest frame has become `version`."""
        if not self.trained_from or self.frames == 0:
            return {"trained_from": ""}
        return {"trained_from": self.trained_from, "lead": version + 1 - self.frames}
