"""When a new keyframe is due: by time, by churn, by the size of what a late viewer needs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from streamlod.codec.encoder import encode_keyframe
from streamlod.codec.refresh import RefreshRule, RefreshSchedule, catch_up_bytes, churn, keyframe_bytes
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.keyframe import as_keyframe
from tests.codec.scenes import grow, make_scene, move

KEY = make_scene((100, 1500), slots=2, features=4)
KEY_BYTES = len(encode_keyframe(KEY, time_ns=0))
RULE = RefreshRule(max_age=50, min_age=3, checked_every=1)


def _still(version: int) -> Scene:
    return replace(KEY, version=version)


def test_a_still_scene_is_renewed_by_time_alone() -> None:
    assert [RULE.reason(KEY, _still(version), keyframe_bytes) for version in (0, 3, 49, 50)] == [
        None,
        None,
        None,
        "time",
    ]


def test_churn_counts_added_and_removed_anchors() -> None:
    grown = grow(KEY, added=6, removed=5)
    rule = replace(RULE, churn_share=0.1)
    assert churn(KEY, KEY) == 0
    assert churn(KEY, grown) == sum(len(level) for level in grown.levels) - KEY.anchor_count + 10
    assert rule.reason(KEY, replace(grown, version=5), keyframe_bytes) is None
    much = grow(KEY, added=90, removed=60)
    assert rule.reason(KEY, replace(much, version=5), keyframe_bytes) == "churn"
    assert rule.reason(KEY, replace(much, version=2), keyframe_bytes) is None  # too soon


def test_a_catch_up_packet_that_outgrows_its_share_calls_for_a_keyframe() -> None:
    now = KEY
    sizes, reasons = [], []
    for seed in range(12):
        now = move(now, seed, share=0.7)
        sizes.append(catch_up_bytes(KEY, now))
        reasons.append(RULE.reason(KEY, now, keyframe_bytes))
    first = reasons.index("catch-up")
    assert first >= RULE.min_age - 1
    for size, reason, age in zip(sizes, reasons, range(1, 13), strict=True):
        expected = age >= RULE.min_age and size > 0.35 * KEY_BYTES
        assert reason == ("catch-up" if expected else None)


def test_the_packet_is_only_sized_now_and_then() -> None:
    now = replace(move(KEY, share=1.0), version=15)
    rule = replace(RULE, catch_up_share=0.001, checked_every=10)
    assert rule.reason(KEY, now, keyframe_bytes) is None
    assert rule.reason(KEY, replace(now, version=20), keyframe_bytes) == "catch-up"


def test_states_of_another_keyframe_are_refused() -> None:
    with pytest.raises(ValueError, match="keyframes"):
        RULE.reason(KEY, replace(KEY, keyframe=3, version=8), keyframe_bytes)


def test_a_watch_follows_a_stream_over_its_keyframes() -> None:
    watch, state, keyframes = RefreshSchedule(replace(RULE, max_age=6)), KEY, list[tuple[int, str]]()
    for seed in range(12):
        before, state = state, move(state, seed, share=0.02 if seed < 6 else 0.7)
        reason = watch.due(before, state)
        if reason is not None:
            keyframes.append((state.version, reason))
            state = as_keyframe(state, state.version)
    assert keyframes == [(6, "time"), (9, "catch-up"), (12, "catch-up")]


def test_a_keyframe_is_sized_only_for_a_check_of_the_catch_up_packet() -> None:
    asked = list[int]()

    def size_bytes(key: Scene) -> int:
        asked.append(key.version)
        return 10**9

    watch, state = RefreshSchedule(replace(RULE, min_age=5, checked_every=4), size_bytes), KEY
    for seed in range(9):
        before, state = state, move(state, seed, share=0.02)
        assert watch.due(before, state) is None
    assert asked == [KEY.version]  # at age 8, not before


def test_the_schedule_must_see_the_keyframe() -> None:
    with pytest.raises(ValueError, match="call due for every state"):
        RefreshSchedule(RULE).due(_still(4), _still(5))
