"""Corners that one camera saw, as curves in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float64, Int64, nearest_of

MIN_CORNERS = 6  # of a picture that is used
_STILL = 0.02  # of a period: so near to its picture's time, a corner without neighbours in time may be used
_STRAIGHT = 0.1  # the same of one with a single neighbour, as boards do not move straight on
_GAP = 1.5  # periods: pictures that are so much farther apart than usual are no neighbours
SPAN_S = 1 / 15  # between neighbours, at least: those of a fast camera lie too near to tell how a corner moves


@dataclass(frozen=True, slots=True, eq=False)
class CornerCurve:
    """Corners near some times, as parabolas about the nearest picture: value + slope * t + bend * t^2.

    Attributes:
        picture_time: [N] seconds by the camera's clock; t counts from there.
        value, slope, bend: [N,J,2] pixels, pixels a second, and half the acceleration; NaN where not known.
        neighbours: [N,J,2] one over the seconds to the pictures before and after that the curve goes through, 0 without
            one.
        error: [N,J] pixels by which the parabola may be off at the times, estimated from four pictures; 0 where it goes
            through fewer than three.
    """

    picture_time: Float64
    value: Float64
    slope: Float64
    bend: Float64
    neighbours: Float64
    error: Float64

    def at(self, times: Float64) -> Float64:
        """[N,J,2] pixels at `times` [N] by the camera's clock."""
        t = (times - self.picture_time)[:, None, None]
        return np.asarray(self.value + t * (self.slope + t * self.bend), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Corners that one camera saw.

    Attributes:
        camera: name. size: (width, height) of its pictures in pixels.
        times: [K] seconds by the camera's own clock, ascending.
        corners: [K,J,2] pixels, NaN where not seen.
    """

    camera: str
    size: tuple[int, int]
    times: Float64
    corners: Float64

    @property
    def seen(self) -> Int64:
        """[K] number of corners seen in each picture."""
        return np.asarray(np.isfinite(self.corners[..., 0]).sum(axis=1), np.int64)

    @property
    def period(self) -> float:
        """Median seconds between pictures."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 1.0

    def near(self, times: Float64) -> CornerCurve:
        """Curves of all corners near `times` [N], ascending, by the camera's clock.

        A parabola goes through the corner in the nearest picture and in those a fifteenth of a second before and after
        it, or in the adjacent ones where these are farther away. With one of them missing it is a line, used near the
        picture's time alone; with both missing, the corner is used at its picture's time alone.
        """
        nearest = nearest_of(self.times, times)
        here = self.corners[nearest]
        apart = max(1, round(SPAN_S / self.period))
        before, h = self._neighbour(nearest, -apart)
        behind, k = self._neighbour(nearest, apart)
        back, ahead = (here - before) / h[:, None, None], (behind - here) / k[:, None, None]
        total = (h + k)[:, None, None]
        bend = (ahead - back) / total
        slope = (back * k[:, None, None] + ahead * h[:, None, None]) / total
        alone = np.isfinite(here) & ~np.isfinite(back) & ~np.isfinite(ahead)
        line = np.where(np.isfinite(back), back, ahead)
        slope = np.where(np.isfinite(slope), slope, np.where(alone, 0.0, line))
        bend = np.where(np.isfinite(bend), bend, 0.0)
        away = (np.abs(times - self.times[nearest]) / self.period)[:, None, None]
        reach = np.where(np.isfinite(back) & np.isfinite(ahead), 1.0, np.where(alone, _STILL, _STRAIGHT))
        unusable = away > reach
        rates = [np.where(np.isfinite(b[..., 0]), 1 / s[:, None], 0.0) for b, s in ((back, h), (ahead, k))]
        t = times - self.times[nearest]
        beyond = np.abs(t * (t + h) * (t - k))[:, None]  # of a cubic, by how much it leaves a parabola through three
        error = np.where(
            np.isfinite(back[..., 0]) & np.isfinite(ahead[..., 0]), self._jerks(apart)[nearest] * beyond, 0
        )
        value = np.where(unusable, np.nan, here)
        return CornerCurve(self.times[nearest], value, slope, bend, np.stack(rates, axis=-1), error)

    def _jerks(self, apart: int) -> Float64:
        """[K,J] a sixth of the third derivative of corners, in pixels a second cubed, by four pictures about each, so
        many apart; the median where one of them is missing."""
        size, count = np.full((2, *self.corners.shape[:2]), np.nan), len(self.times) - 3 * apart
        if count > 0:
            rows = np.arange(count)[:, None] + apart * np.arange(4)
            times, found = self.times[rows], self.corners[rows]
            for order in (1, 2, 3):  # of Newton's divided differences
                found = np.diff(found, axis=1) / (times[:, order:] - times[:, :-order])[..., None, None]
            lasting = (np.diff(times, axis=1) < (apart + _GAP) * self.period).all(axis=1)
            jerks = np.where(lasting[:, None], np.linalg.norm(found[:, 0], axis=-1), np.nan)
            size[0, apart : apart + count] = size[1, 2 * apart : 2 * apart + count] = jerks
        whole = np.fmax(*size)
        known = whole[np.isfinite(whole)]
        return np.where(np.isfinite(whole), whole, float(np.median(known)) if len(known) else 0.0)

    def _neighbour(self, rows: Int64, step: int) -> tuple[Float64, Float64]:
        """[N,J,2] corners so many pictures before or after, and [N] seconds between."""
        other = np.clip(rows + step, 0, len(self.times) - 1)
        seconds = np.abs(self.times[other] - self.times[rows])
        usable = (seconds > 0) & (seconds < (abs(step) + _GAP) * self.period)
        return np.where(usable[:, None, None], self.corners[other], np.nan), np.where(usable, seconds, 1.0)
