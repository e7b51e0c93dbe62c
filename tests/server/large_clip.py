"""A clip whose keyframes are as large as those of real streams, made without training."""

from __future__ import annotations

from pathlib import Path

from tests.server.conftest import Clip, make_clip

COUNTS = (50, 200, 800, 7000)  # anchors of each level
KEYFRAME_BYTES = 300_000  # at least
KEY_EVERY = 3  # frames


def make_large_clip(folder: Path) -> Clip:
    """Nine frames at ten a second, of which three are keyframes of more than `KEYFRAME_BYTES`.

    Played in a loop, it brings a refresh keyframe every 0.3 s.
    """
    clip = make_clip(folder / "large.slod", 3 * KEY_EVERY, COUNTS, KEY_EVERY, frame_ns=100_000_000)
    assert all(len(packet) > KEYFRAME_BYTES for packet in clip.packets[::KEY_EVERY])
    return clip
