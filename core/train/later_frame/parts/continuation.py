"""Training begins where the anchor's motion goes on, since motion mostly continues."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float32
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.later_frame.part import Beginning, FramePart, Hooks
from streamlod.core.train.later_frame.update import IntegerUpdate
from streamlod.core.train.setting import left_out, setting

_CHANGE, _START = "continuation.change", "continuation.start"
_MAX_REMAINDER = 2.0  # steps; more is not left by rounding, but a change that could not be sent
_MAX_CONTINUATION = 64.0  # steps: one wild change must not throw an anchor out of the scene


@dataclass(frozen=True, slots=True)
class Continuation(FramePart):
    """Anchors begin with a share of their latest change.

    State columns: [N,27] latents and positions in steps, of the latest change and where the next training begins.
    """

    name: ClassVar[str] = "continuation"

    share: float = setting(
        0.9,
        "share of the latest change that an anchor begins with, where the one before it pointed the same way",
        left_out("training begins at the frame before"),
    )

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        columns = seen.state.columns
        nothing = torch.zeros(len(seen.rows), LATENTS + 3, device=seen.rows.device)
        change, start = (columns[name][seen.rows] if name in columns else nothing for name in (_CHANGE, _START))
        return _Continuing(self.share, change, start)


@dataclass(frozen=True, slots=True, eq=False)
class _Continuing(Hooks):
    share: float
    before: Tensor
    begins: Tensor

    def start(self, values: dict[str, Tensor]) -> dict[str, Tensor]:
        return values | {"latent": self.begins[:, :LATENTS], "position": self.begins[:, LATENTS:]}

    def columns(self, update: IntegerUpdate, *, done: bool) -> dict[str, Tensor]:
        start = continued(update, self.share, self.before.cpu().numpy(), done=done)
        return {_CHANGE: torch.from_numpy(update.sent), _START: torch.from_numpy(start)}


def continued(update: IntegerUpdate, share: float, before: Float32, *, done: bool) -> Float32:
    """[n,27] where the next frame's training begins: `share` of this change, and what it left undone.

    Only where the change `before` [n,27] had the same sign: a flash is over in the next frame.

    Args:
        done: nothing was cut short; otherwise `remainder` is added.
    """
    sent = update.sent
    onwards = np.clip(np.float32(share) * sent * (sent * before > 0), -_MAX_CONTINUATION, _MAX_CONTINUATION)
    return np.asarray(onwards if done else onwards + remainder(update))


def remainder(update: IntegerUpdate) -> Float32:
    """[n,27] what rounding and dropped changes left undone, in steps."""
    sent = update.sent
    if update.wanted is None:
        return np.zeros_like(sent)
    return np.asarray(np.clip(update.wanted - sent, -_MAX_REMAINDER, _MAX_REMAINDER))
