"""When a refresh keyframe is worth its bytes: catch-up packets grow with its age."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference

Reason = Literal["time", "churn", "catch-up"]


@dataclass(frozen=True, slots=True)
class RefreshRule:
    """When to send a refresh keyframe.

    Attributes:
        max_age: most versions from one keyframe to the next.
        min_age: fewest versions from one keyframe to the next.
        catch_up_share: a keyframe is due when the catch-up packet reaches this share of the old keyframe's bytes.
        churn_share: or when so many anchors were added and removed, as a share of those that the keyframe had.
        checked_every: versions between checks of the catch-up packet, which has to be encoded to know its size.
    """

    max_age: int = 100
    min_age: int = 30
    catch_up_share: float = 0.35
    churn_share: float = 0.35
    checked_every: int = 10

    def reason(self, key: Scene, now: Scene, size_bytes: Callable[[Scene], int]) -> Reason | None:
        """Why a keyframe is due at `now`, or None.

        Args:
            key: the keyframe's state.
            now: a later state under it.
            size_bytes: of a keyframe's packet; called only when the catch-up packet is checked.

        Raises:
            ValueError: the states belong to different keyframes.
        """
        age = now.version - key.version
        if age >= self.max_age:
            return "time"
        if age < self.min_age:
            return None
        if churn(key, now) > self.churn_share * max(key.anchor_count, 1):
            return "churn"
        if age % self.checked_every == 0 and catch_up_bytes(key, now) > self.catch_up_share * size_bytes(key):
            return "catch-up"
        return None


def keyframe_bytes(key: Scene) -> int:
    """Size of a keyframe's packet."""
    return len(encode_keyframe(key, time_ns=0))


class RefreshSchedule:
    """Follows a stream's states and says when a refresh keyframe is due.

    Args:
        rule: says when.
        size_bytes: size of a keyframe's packet, for callers that have it already; by default it is encoded to know.
    """

    def __init__(self, rule: RefreshRule, size_bytes: Callable[[Scene], int] = keyframe_bytes) -> None:
        self._rule, self._size_bytes = rule, size_bytes
        self._key: Scene | None = None

    def due(self, before: Scene, now: Scene) -> Reason | None:
        """Why a keyframe should follow the state `now`, or None. Call it for every state, with the one `before`."""
        if before.version == before.keyframe:
            self._key = before
        if self._key is None or self._key.keyframe != now.keyframe:
            raise ValueError(f"keyframe {now.keyframe} is unknown here; call due for every state")
        return self._rule.reason(self._key, now, self._size_bytes)


def churn(key: Scene, now: Scene) -> int:
    """Anchors added since `key`, and anchors removed."""
    added = sum(len(after) - len(before) for before, after in zip(key.levels, now.levels, strict=True))
    removed = sum(int((~level.alive).sum()) for level in now.levels)
    return added + removed


def catch_up_bytes(key: Scene, now: Scene) -> int:
    """Size of the packet from `key` to `now`."""
    return len(encode_residual(key, difference(key, now), time_ns=0))
