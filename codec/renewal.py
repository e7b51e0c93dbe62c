"""When a new keyframe is worth its bytes: the older one gets, the more a viewer who joins must be sent beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from codec.encoder import encode_keyframe, encode_residual
from codec.packet.packet import PacketKind
from core.scene.anchors import Scene
from core.scene.residual import difference

Reason = Literal["time", "churn", "catch-up"]


@dataclass(frozen=True, slots=True)
class RenewalRule:
    """When to send a new keyframe.

    Attributes:
        longest: versions after which one comes in any case.
        shortest: versions before which none comes, so that no scene is sent over and over.
        catch_up_share: a catch-up packet of this share of the keyframe's bytes calls for a new one.
        churn_share: anchors added and removed, of those that the keyframe had.
        checked_every: versions between looks at the catch-up packet, which has to be encoded for it.
    """

    longest: int = 100
    shortest: int = 30
    catch_up_share: float = 0.35
    churn_share: float = 0.1
    checked_every: int = 10

    def reason(self, key: Scene, key_bytes: int, now: Scene) -> Reason | None:
        """Why a keyframe is due at `now`, or None.

        Args:
            key: the keyframe's state; key_bytes: size of its packet.
            now: a later state under it.

        Raises:
            ValueError: the states belong to different keyframes.
        """
        age = now.version - key.version
        if age >= self.longest:
            return "time"
        if age < self.shortest:
            return None
        if churn(key, now) > self.churn_share * max(key.anchor_count, 1):
            return "churn"
        if age % self.checked_every == 0 and catch_up_bytes(key, now) > self.catch_up_share * key_bytes:
            return "catch-up"
        return None


class Renewal:
    """Watches a stream's states and says when a keyframe is due."""

    def __init__(self, rule: RenewalRule) -> None:
        self._rule = rule
        self._key: Scene | None = None
        self._key_bytes = 0

    def due(self, before: Scene, now: Scene) -> Reason | None:
        """Why a keyframe should follow `now`, whose predecessor was `before`; every state has to pass by here."""
        if before.version == before.keyframe:
            self._key, self._key_bytes = before, len(encode_keyframe(before, time_ns=0))
        if self._key is None or self._key.keyframe != now.keyframe:
            raise ValueError(f"keyframe {now.keyframe} was never shown to this watch")
        return self._rule.reason(self._key, self._key_bytes, now)


def churn(key: Scene, now: Scene) -> int:
    """Anchors added since `key`, and anchors removed."""
    added = sum(len(after) - len(before) for before, after in zip(key.levels, now.levels, strict=True))
    removed = sum(int((~level.alive).sum()) for level in now.levels)
    return added + removed


def catch_up_bytes(key: Scene, now: Scene) -> int:
    """Size of the packet from `key` to `now`."""
    return len(encode_residual(key, difference(key, now), kind=PacketKind.CATCH_UP, time_ns=0))
