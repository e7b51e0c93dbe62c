"""What `streamlod study | tradeoff` do: the evaluation of `core.evaluate`, with the sizes of real packets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from codec.encoder import encode_keyframe, encode_residual
from codec.packet import PacketKind
from codec.packet_info import peek
from core.anchors import Scene
from core.evaluate.sizes import PacketSize
from core.residual import Residual

if TYPE_CHECKING:
    from core.evaluate.study import StudyOptions
    from core.evaluate.tradeoff import TradeoffOptions


def study(data: Path, out: Path, options: StudyOptions) -> str:
    """Compare the method with its parts left out."""
    from core.evaluate.study import run_study

    return run_study(data, out, options, packet_size)


def tradeoff(data: Path, out: Path, options: TradeoffOptions) -> str:
    """Sweep time, size and quality against each other."""
    from core.evaluate.tradeoff import run_tradeoff

    return run_tradeoff(data, out, options, packet_size)


def packet_size(before: Scene | None, after: Scene, residual: Residual | None) -> PacketSize:
    """What a frame's packet costs: a keyframe's where there is no residual."""
    if before is None or residual is None:
        packet = encode_keyframe(after, time_ns=0)
    else:
        packet = encode_residual(before, residual, kind=PacketKind.PREDICTED, time_ns=0)
    return PacketSize(len(packet), peek(packet).level_bytes)
