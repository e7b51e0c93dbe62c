"""Packets carry states exactly: key, predicted, skip, catch-up, levels apart."""

from __future__ import annotations

from dataclasses import replace

import pytest

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.levels import drop_levels, select_levels, split_levels
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.residual import difference
from tests.codec.scenes import assert_same_level, assert_same_state, grow, make_scene, move, steps

PROFILES = (0, 1)


@pytest.mark.parametrize("profile", PROFILES)
def test_keyframe_and_chain_arrive_exactly(profile: int) -> None:
    states, residuals = steps(make_scene(), 4)
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(states[0], time_ns=5, profile=profile))
    assert_same_state(states[0], decoder.scene)
    for before, after, residual in zip(states, states[1:], residuals, strict=False):
        packet = encode_residual(before, residual, time_ns=9, profile=profile)
        info = decoder.push(packet)
        assert (info.size_bytes, info.time_ns, info.to_version) == (len(packet), 9, after.version)
        assert_same_state(after, decoder.scene)


@pytest.mark.parametrize("profile", PROFILES)
def test_skip_equals_the_predicted_packets_it_replaces(profile: int) -> None:
    first = make_scene()
    second = grow(move(first))
    third = move(grow(second, seed=3))
    chain, direct = SceneDecoder(), SceneDecoder()
    key = encode_keyframe(first, time_ns=0, profile=profile)
    for decoder in (chain, direct):
        decoder.push(key)
    for a, b in ((first, second), (second, third)):
        chain.push(encode_residual(a, difference(a, b), time_ns=1, profile=profile))
    direct.push(encode_residual(first, difference(first, third), time_ns=1, profile=profile))
    assert_same_state(third, chain.scene)
    assert_same_state(third, direct.scene)


@pytest.mark.parametrize("profile", PROFILES)
def test_dropping_levels_commutes_with_decoding(profile: int) -> None:
    states, residuals = steps(make_scene(), 1)
    key = encode_keyframe(states[0], time_ns=0, profile=profile)
    packet = encode_residual(states[0], residuals[0], time_ns=1, profile=profile)
    decoder = SceneDecoder()
    decoder.push(drop_levels(key, 1))
    decoder.push(drop_levels(packet, 0))
    assert decoder.versions == (1, 0, -1)
    assert decoder.scene is not None
    assert_same_level(states[1].levels[0], decoder.scene.levels[0])
    assert_same_level(states[0].levels[1], decoder.scene.levels[1])
    assert len(decoder.scene.levels[2]) == 0


@pytest.mark.parametrize("profile", PROFILES)
def test_a_keyframe_trickles_and_lagging_levels_catch_up(profile: int) -> None:
    states, residuals = steps(make_scene(), 2)
    parts = split_levels(encode_keyframe(states[0], time_ns=0, profile=profile))
    assert [peek(part).has_header for part in parts] == [True, False, False]
    chain = [encode_residual(a, r, time_ns=1, profile=profile) for a, r in zip(states, residuals, strict=False)]
    decoder = SceneDecoder()
    for packet in (parts[0], chain[0], parts[1], chain[1], parts[2]):
        decoder.push(packet)
    assert decoder.versions == (2, 0, 0)
    total = difference(states[0], states[2])
    catch_up = encode_residual(states[0], total, time_ns=1, profile=profile)
    decoder.push(select_levels(catch_up, 0b110))
    assert decoder.versions == (2, 2, 2)
    assert_same_state(states[2], decoder.scene)


def test_packets_out_of_place_are_refused_and_change_nothing() -> None:
    states, residuals = steps(make_scene(), 2)
    key = encode_keyframe(states[0], time_ns=0)
    second = encode_residual(states[1], residuals[1], time_ns=1)
    decoder = SceneDecoder()
    with pytest.raises(BitstreamError) as refused:
        decoder.push(second)
    assert refused.value.code == "no_keyframe"
    decoder.push(key)
    with pytest.raises(BitstreamError) as refused:
        decoder.push(second)
    assert refused.value.code == "version_mismatch"
    assert_same_state(states[0], decoder.scene)


def test_a_still_frame_is_tiny() -> None:
    scene = replace(make_scene(), version=1)
    packet = encode_residual(scene, difference(scene, replace(scene, version=2)), time_ns=1)
    assert len(packet) <= 64
