"""What `streamlod study | tradeoff` do: the evaluation of `client.evaluation`, with the sizes of real packets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from client.evaluation.measure.sizes import PacketSize
from codec.encoder import encode_keyframe, encode_residual
from codec.packet.info import peek
from codec.packet.packet import PacketKind
from core.scene.anchors import Scene
from core.scene.residual import Residual

if TYPE_CHECKING:
    from client.evaluation.study import StudyOptions
    from client.evaluation.tradeoff import TradeoffOptions


def study(data: Path, out: Path, options: StudyOptions) -> str:
    """Compare the method with its parts left out."""
    from client.evaluation.study import run_study

    return run_study(data, out, options, packet_size)


def tradeoff(data: Path, out: Path, options: TradeoffOptions) -> str:
    """Sweep time, size and quality against each other."""
    from client.evaluation.tradeoff import run_tradeoff

    return run_tradeoff(data, out, options, packet_size)


def packet_size(before: Scene | None, after: Scene, residual: Residual | None) -> PacketSize:
    """What a frame's packet costs: a keyframe's where there is no residual."""
    if before is None or residual is None:
        packet = encode_keyframe(after, time_ns=0)
    else:
        packet = encode_residual(before, residual, kind=PacketKind.PREDICTED, time_ns=0)
    return PacketSize(len(packet), peek(packet).level_bytes)
