"""Residuals are rounded towards zero, and training sees what is sent."""

from __future__ import annotations

import torch

from streamlod.core.train.field.rounding import dead_zone, dead_zone_through

VALUES = torch.tensor([0.0, 0.65, 0.67, -0.65, -0.67, 1.65, 1.67, -2.9])
ROUNDED = [0, 0, 1, 0, -1, 1, 2, -3]


def test_known_values() -> None:
    assert dead_zone(VALUES).tolist() == ROUNDED


def test_gradients_pass_as_though_nothing_were_rounded() -> None:
    values = VALUES.clone().requires_grad_()
    rounded = dead_zone_through(values)
    torch.testing.assert_close(rounded.detach(), torch.tensor(ROUNDED, dtype=torch.float32))
    rounded.sum().backward()  # type: ignore[no-untyped-call]
    assert values.grad is not None
    assert values.grad.tolist() == [1.0] * len(VALUES)
