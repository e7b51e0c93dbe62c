"""Residuals are rounded towards zero."""

from __future__ import annotations

import torch

from streamlod.core.train.field.rounding import dead_zone

VALUES = torch.tensor([0.0, 0.65, 0.67, -0.65, -0.67, 1.65, 1.67, -2.9])
ROUNDED = [0, 0, 1, 0, -1, 1, 2, -3]


def test_known_values() -> None:
    assert dead_zone(VALUES).tolist() == ROUNDED
