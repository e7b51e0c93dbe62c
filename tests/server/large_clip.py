"""A clip whose keyframes are as large as those of real streams, made without training."""

from __future__ import annotations

from pathlib import Path

from tests.codec.scenes import assert_same_state
from tests.server.conftest import Clip, Viewer, make_clip

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


def see_keyframes(viewer: Viewer, large: Clip, count: int) -> None:
    """Watch until `viewer` has decoded more than `count` keyframes, each state equal to the clip's."""
    viewer.hello().until("caught_up")
    keyframes: set[tuple[int, int]] = set()
    while len(keyframes) <= count:
        viewer.step()
        scene = viewer.decoder.scene
        if scene is not None and len(set(viewer.decoder.versions)) == 1:
            keyframes.add((len(viewer.named("epoch")), scene.keyframe))
            assert_same_state(large.states[scene.version], scene)
