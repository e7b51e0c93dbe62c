"""The last stage: a trained state becomes packets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.refresh import keyframe_bytes
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.metadata import Metadata
from streamlod.core.scene.residual import Residual
from streamlod.server.pipeline.stages.trace import Span, timing


@dataclass(frozen=True, slots=True, eq=False)
class TrainedState:
    """A trained state, to be encoded.

    Attributes:
        scene: the state.
        time_ns: its presentation time.
        change: the state before, and the residual from it; None where `scene` itself is to be sent.
        packet: of the change, where rate control had to know its size at once.
        refresh: a keyframe of the same instant, to be sent after the change, or None.
        preview, report, spans: as in `EncodedFrame`.
        captured: when the frame was filmed, in seconds of `time.perf_counter`; None for files.
    """

    scene: Scene
    time_ns: int
    report: dict[str, Any]
    change: tuple[Scene, Residual] | None = None
    refresh: Scene | None = None
    preview: bool = False
    spans: tuple[Span, ...] = ()
    captured: float | None = None
    packet: bytes | None = None

    def changing(self) -> bytes:
        """The packet of the change."""
        assert self.change is not None
        return encode_residual(*self.change, time_ns=self.time_ns)


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """One frame's packets with the figures of its training.

    Attributes:
        version: of the state that the packets lead to.
        packets: one, or two where a new keyframe follows the frame's residual.
        report: figures, as JSON values.
        preview: whether the packet is an early, unfinished keyframe.
        spans: when its stages ran.
    """

    version: int
    packets: tuple[bytes, ...]
    report: dict[str, Any]
    preview: bool = False
    spans: tuple[Span, ...] = ()


class KeyframeSize:
    """Bytes of the newest keyframe's packet, which the encoding stage tells the training stage."""

    def __init__(self) -> None:
        self._newest = -1, 0  # version and bytes: one value, as two threads use it

    def note(self, keyframe: Scene, packet: bytes) -> bytes:
        """`packet`, which is the keyframe's."""
        self._newest = keyframe.version, len(packet)
        return packet

    def size_bytes(self, keyframe: Scene) -> int:
        """Bytes of the keyframe's packet, which is encoded once more where this process has not sent it."""
        version, size = self._newest
        return size if version == keyframe.version else keyframe_bytes(keyframe)


def encoded(state: TrainedState, size: KeyframeSize, facts: Metadata) -> EncodedFrame:
    """All packets of a state, keyframes with `facts`, and the time that encoding took in its report."""

    def keyframe(scene: Scene) -> bytes:
        told = replace(scene, metadata=replace(scene.metadata, title=facts.title, licence=facts.licence))
        return size.note(scene, encode_keyframe(told, time_ns=state.time_ns))

    def encode() -> Iterator[bytes]:
        if state.change is None:
            yield keyframe(state.scene)
        else:
            yield state.packet or state.changing()
        if state.refresh is not None:
            yield keyframe(state.refresh)

    packets, span = timing("encode", lambda: tuple(encode()))
    report, seconds = state.report, span.end - span.begin
    if not state.preview:
        report = {**report, "seconds": {**report["seconds"], "encode": seconds}}
        report["total_seconds"] += seconds
    if state.captured is not None:
        report = {**report, "latency_seconds": span.end - state.captured}
    return EncodedFrame(state.scene.version, packets, report, state.preview, (*state.spans, span))
