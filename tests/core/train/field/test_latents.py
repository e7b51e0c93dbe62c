"""Latents change one channel each: the ones in which features differ most, and every offset where they suffice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from streamlod.core.camera import look_at, pinhole
from streamlod.core.scene.anchors import FEATURE_LATENTS, OFFSET_LATENTS, AnchorWeights
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import Precision, usual_precision
from tests.core.train.fields import random_field

PREDICT = PredictConfig(feature_step=0.5, offset_step=0.25)
CAMERA = pinhole(
    "cam0", (64, 64), (32, 32), (64, 64), look_at(np.array([0, 0, -3.0]), np.zeros(3), np.array([0, -1.0, 0]))
)


def weights_of(field: Field, precision: Precision | None = None) -> AnchorWeights:
    return scene_of(field, PREDICT, (CAMERA,), 30.0, 0, precision).weights


def wide_field(slots: int = 2) -> Field:
    """Features of 16 channels, of which each differs 1.4 times as much as the one before it, but for a common part."""
    field = random_field(100, slots)
    generator = torch.Generator().manual_seed(3)
    spread = 2.0 ** (torch.arange(16) / 2 - 4)
    values = torch.randn(100, 16, generator=generator) * spread + 5 * (torch.arange(16) == 2)
    hidden = torch.cat([field.network.hidden_weight[:8], field.network.hidden_weight])
    return replace(field, feature=values, network=replace(field.network, hidden_weight=hidden))


def test_each_latent_changes_one_of_the_channels_that_differ_most() -> None:
    decoder = weights_of(wide_field()).feature_decoder
    assert decoder.shape == (FEATURE_LATENTS, 16)
    wanted = np.zeros_like(decoder)
    wanted[np.arange(12), np.arange(15, 3, -1)] = 0.5  # a large mean, as channel 2 has it, is no difference
    np.testing.assert_array_equal(decoder, wanted)


def test_channels_are_those_of_the_basis_in_which_features_are_sent() -> None:
    """There a step has the length that steps of `feature_step` have on average."""
    field = wide_field()
    turn, _ = torch.linalg.qr(torch.randn(16, 16, generator=torch.Generator().manual_seed(0)))
    basis = 3 * turn
    precision = replace(usual_precision(field, 0), basis=basis, inverse=torch.linalg.inv(basis))
    decoder = weights_of(field, precision).feature_decoder
    assert (np.count_nonzero(decoder, axis=1) == 1).all()
    assert (np.count_nonzero(decoder, axis=0) <= 1).all()
    np.testing.assert_allclose(decoder.max(axis=1), 1.5, rtol=1e-3)
    chosen = (field.feature @ basis).std(dim=0).argsort(descending=True)[:FEATURE_LATENTS]
    np.testing.assert_array_equal(decoder.argmax(axis=1), chosen.numpy())


def test_fewer_channels_than_latents_leave_latents_without_effect() -> None:
    decoder = weights_of(random_field(50, 2)).feature_decoder
    np.testing.assert_array_equal(np.sort(np.linalg.norm(decoder, axis=1)), [0] * 4 + [0.5] * 8)


def test_a_field_without_anchors_has_decoders_too() -> None:
    field = random_field(50, 2)
    decoder = weights_of(field.with_rows(torch.zeros(0, dtype=torch.int64))).feature_decoder
    assert np.isfinite(decoder).all()
    assert np.count_nonzero(decoder) == 8


def test_every_offset_has_a_latent_where_there_are_enough() -> None:
    decoder = weights_of(random_field(50, 4)).offset_decoder
    np.testing.assert_array_equal(decoder, 0.25 * np.eye(OFFSET_LATENTS))
    few = weights_of(random_field(50, 2)).offset_decoder
    np.testing.assert_array_equal(few, 0.25 * np.eye(OFFSET_LATENTS, 6))


def test_where_there_are_not_latents_share_all_offsets() -> None:
    decoder = weights_of(random_field(50, 10)).offset_decoder
    assert decoder.shape == (OFFSET_LATENTS, 30)
    np.testing.assert_allclose(decoder @ decoder.T, 0.25**2 * np.eye(OFFSET_LATENTS), atol=1e-4)
