"""Gaps in what was filmed, as where phones were away: what plays it shows the picture before for so long at most."""

from __future__ import annotations

MAX_GAP_SECONDS = 10.0  # of filming; training on a slow machine leaves up to nine seconds between two frames
