"""A rekeyed scene shows the same, is in order, and can be sent as keyframe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import dequantise, expand
from streamlod.core.scene.keyframe import as_keyframe, living_rows
from streamlod.core.scene.octree import morton_key
from tests.codec.scenes import assert_same_state, grow, make_scene, move


def keyframe_error(before: Scene, after: Scene) -> tuple[float, float]:
    """Largest change of a feature and of an offset between a scene and the same scene as a keyframe, in their steps.

    At most half of the multiple that the anchor is rounded to, unless a value left the range of int16.
    """
    feature_error = offset_error = 0.0
    for old, new in zip(before.levels, after.levels, strict=True):
        rows = living_rows(old)
        feature, offset, _ = dequantise(before.header, before.weights, old, rows)
        new_feature, new_offset, _ = dequantise(after.header, after.weights, new, np.arange(len(new)))
        feature_change = np.abs(new_feature - feature) / before.header.feature_steps
        offset_change = np.abs(new_offset - offset).reshape(len(rows), old.offset.shape[1]) / before.header.offset_steps
        feature_error = max(feature_error, float(feature_change.max(initial=0)))
        offset_error = max(offset_error, float(offset_change.max(initial=0)))
    return feature_error, offset_error


def test_a_late_state_becomes_a_keyframe() -> None:
    late = grow(move(grow(move(make_scene(), share=0.5)), share=0.5))
    fresh = as_keyframe(late, 17)
    assert (fresh.keyframe, fresh.version) == (17, 17)
    assert fresh.anchor_count == late.anchor_count == sum(map(len, fresh.levels))
    for level in fresh.levels:
        assert (np.diff(morton_key(level.voxel)) >= 0).all()
        assert not level.latent.any()
    feature, offset = keyframe_error(late, fresh)
    assert 0 < feature <= 0.5001
    assert 0 < offset <= 0.5001
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(fresh, time_ns=0))
    assert_same_state(fresh, decoder.scene)


def test_a_keyframe_stays_as_it_is() -> None:
    scene = make_scene()
    again = as_keyframe(scene, 0)
    assert_same_state(scene, again)
    assert max(keyframe_error(scene, again)) < 1e-3


def test_what_is_shown_stays_within_rounding() -> None:
    scene = make_scene()
    weights = replace(scene.weights, **{n: getattr(scene.weights, n) * 0.125 for n in scene.weights.__slots__})
    late = move(replace(scene, weights=weights), share=0.5)
    eye = np.array([0.3, 0.1, -4.0])
    before, after = expand(late, eye), expand(as_keyframe(late, 1), eye)
    assert abs(len(before) - len(after)) <= 0.02 * len(before)
    np.testing.assert_allclose(before.means.mean(axis=0), after.means.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(before.colours.mean(axis=0), after.colours.mean(axis=0), atol=0.01)


def test_an_anchor_stays_as_coarse_as_it_was() -> None:
    scene = make_scene((200,), slots=2, features=4)
    level = scene.levels[0]
    coarse = {name: getattr(level, name) * np.int16(8) for name in ("feature", "offset", "scaling")}
    scene = replace(scene, levels=(replace(level, **coarse),))
    after = as_keyframe(move(scene, share=1.0), 1).levels[0]
    assert not any((getattr(after, name) % 8).any() for name in coarse)
    assert (after.feature != coarse["feature"]).any()
