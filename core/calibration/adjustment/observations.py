"""Corners that an adjustment explains: each on its camera's curve near one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float64, Int64
from streamlod.core.calibration.track import Track

_CORNER = 0.2  # pixels, standard error of a corner in a picture


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Corners that are explained, N of them.

    Attributes:
        camera, instant: [N] numbers.
        point: [N,3] of the board, metres.
        value, slope, bend, neighbours: [N,2] the camera's curve of the corner, see `track.CornerCurve`.
        extent: [N,2] width and height of the camera's picture.
        since: [N] seconds from the curve's picture to the instant, by the common time.
        doubt: [N] standard error of the corner on its curve as a multiple of that in a picture: more than 1, as boards
            do not move along parabolas.
    """

    camera: Int64
    instant: Int64
    point: Float64
    value: Float64
    slope: Float64
    bend: Float64
    neighbours: Float64
    extent: Float64
    since: Float64
    doubt: Float64

    def kept(self, rows: Bool) -> Observations:
        """The observations that the mask `rows` [N] names."""
        return Observations(*(getattr(self, name)[rows] for name in self.__slots__))


def observed(tracks: Sequence[Track], times: Float64, offsets: Float64, board: Float64) -> Observations:
    """The corners at the common `times` [I], on curves about the pictures that are nearest with these `offsets` [C]."""
    parts = []
    for number, (track, offset) in enumerate(zip(tracks, offsets, strict=True)):
        curve = track.near(times - offset)
        instant, corner = np.nonzero(np.isfinite(curve.value[..., 0]))
        camera = np.full(len(instant), number)
        since = (times - curve.picture_time)[instant]
        rows = [values[instant, corner] for values in (curve.value, curve.slope, curve.bend, curve.neighbours)]
        rows.append(np.tile(np.array(track.size, np.float64), (len(instant), 1)))
        doubt = np.hypot(1, curve.error[instant, corner] / _CORNER)
        parts.append((camera, instant, board[corner], *rows, since, doubt))
    return Observations(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def curve_noise(t: Float64, neighbours: Float64) -> tuple[Float64, Float64]:
    """[N,1] noise of corners on their curves relative to that in a picture, and [N,1] its derivative by t.

    By Lagrange's formula a curve is a weighted sum of the corners in three pictures, whose weights depend on t. Outside
    these pictures' times the noise counts as that of one picture.

    Args:
        t: [N] seconds from the nearest picture. neighbours: [N,2] of the curves, see `Observations`.
    """
    before, behind = neighbours.T
    share = before / np.maximum(before + behind, 1e-9)
    weights = np.stack(
        [
            -t * before * (1 - t * behind) * share,
            (1 + t * before) * (1 - t * behind),
            t * behind * (1 + t * before) * (1 - share),
        ]
    )
    growths = np.stack(
        [
            -before * (1 - 2 * t * behind) * share,
            before - behind - 2 * t * before * behind,
            behind * (1 + 2 * t * before) * (1 - share),
        ]
    )
    noise = np.linalg.norm(weights, axis=0)
    growth = (weights * growths).sum(axis=0) / noise
    inside = noise < 1
    return np.where(inside, noise, 1.0)[:, None], np.where(inside, growth, 0.0)[:, None]
