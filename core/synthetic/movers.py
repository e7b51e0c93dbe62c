"""Things that move, for any kind of place: a bouncing ball, a person who waves, a cat that looks over a sofa, a globe.

Each function maps scene time in seconds to the same list of rigid parts, so that a part's pose now and one frame
earlier is its exact motion.
"""

from __future__ import annotations

import math

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.synthetic.parts import Part, ball, limb, turn
from streamlod.core.synthetic.textures import numbers as T

_SKIN, _DENIM, _SHOE, _GINGER = (0.86, 0.64, 0.50), (0.20, 0.28, 0.46), (0.85, 0.84, 0.80), (0.86, 0.54, 0.24)


def bouncing_ball(time: float) -> list[Part]:
    """A beach ball that rolls to and fro across the rug in hops: rigid motion."""
    radius, span, speed = 0.19, 0.85, 1.0
    sweep = (time * speed / span + 0.4) % 4.0
    x = span * (sweep - 1.0 if sweep < 2.0 else 3.0 - sweep)
    hop = (time / 0.62) % 1.0
    height = radius + 0.012 + 0.32 * 4.0 * hop * (1.0 - hop)
    rotation = turn("y", x / radius) @ turn("x", 0.5)
    return [
        ball(
            (x - 0.25, 1.20, height), (radius,) * 3, T.BEACH_BALL, (1.0, 1.0, 1.0), seed=5, rotation=rotation, gloss=0.2
        )
    ]


def person(time: float) -> list[Part]:
    """A figure that sways, turns its head and waves: articulated motion, bones of fixed length."""
    sway = 0.05 * math.sin(2.3 * time)
    hips = np.array([0.78 + sway, 2.35, 0.86])
    lean = turn("y", 0.10 * math.sin(2.3 * time + 0.7)) @ turn("z", 0.12 * math.sin(1.7 * time))
    neck = hips + lean @ np.array([0.0, 0.0, 0.50])
    parts = [
        limb(hips + lean @ np.array([0.0, 0.0, 0.02]), neck - lean @ np.array([0.0, 0.0, 0.10]), 0.165, T.SHIRT,
             (0.70, 0.18, 0.22), seed=11),
        limb(neck - lean @ np.array([0.0, 0.0, 0.06]), neck + lean @ np.array([0.0, 0.0, 0.10]), 0.055, T.PLAIN,
             _SKIN, seed=12),
    ]  # fmt: skip
    gaze = lean @ turn("z", 0.5 * math.sin(1.3 * time)) @ turn("x", 0.12 * math.sin(3.1 * time))
    crown = neck + lean @ np.array([0.0, 0.0, 0.20])
    parts.append(_head(crown, gaze))
    for side in (-1.0, 1.0):
        shoulder = neck + lean @ np.array([0.21 * side, 0.0, -0.09])
        parts += _arm(shoulder, side, time, lean)
        hip = hips + lean @ np.array([0.095 * side, 0.0, -0.02])
        parts += _leg(hip, np.array([0.78 + 0.14 * side, 2.33, 0.07]))
    return parts


def _head(crown: Float64, gaze: Float64) -> Part:
    place = (float(crown[0]), float(crown[1]), float(crown[2]))
    return ball(place, (0.118, 0.125, 0.15), T.FACE, _SKIN, seed=13, rotation=gaze)


def _arm(shoulder: Float64, side: float, time: float, lean: Float64) -> list[Part]:
    """Upper arm, forearm and hand; the one on the right of the picture waves."""
    if side > 0:
        raised, bent = 0.35 + 0.15 * math.sin(2.0 * time), 1.05 + 0.55 * math.sin(7.0 * time)
        upper = np.array([math.cos(raised), -0.25, math.sin(raised)])
        lower = np.array([math.cos(raised + bent), -0.35, math.sin(raised + bent)])
    else:
        swing = 0.35 * math.sin(2.6 * time)
        upper = np.array([-0.35, -math.sin(swing), -math.cos(swing)])
        lower = np.array([-0.10, -0.55 - 0.4 * math.sin(swing + 0.6), -0.75])
    elbow = shoulder + lean @ (0.27 * upper / np.linalg.norm(upper))
    wrist = elbow + lean @ (0.25 * lower / np.linalg.norm(lower))
    palm = wrist + lean @ (0.07 * lower / np.linalg.norm(lower))
    return [
        limb(shoulder, elbow, 0.062, T.SHIRT, (0.70, 0.18, 0.22), seed=14),
        limb(elbow, wrist, 0.046, T.PLAIN, _SKIN, seed=15),
        limb(wrist, palm, 0.052, T.PLAIN, _SKIN, seed=16),
    ]


def _leg(hip: Float64, ankle: Float64) -> list[Part]:
    """Thigh and shin of 0.41 m each between a moving hip and a standing foot; the knee points to the cameras."""
    bone, between = 0.41, ankle - hip
    length = float(np.linalg.norm(between))
    forward = np.array([0.0, -1.0, 0.0]) - between * (between @ np.array([0.0, -1.0, 0.0])) / length**2
    bend = math.sqrt(max(bone**2 - (length / 2) ** 2, 0.0))
    knee = hip + between / 2 + bend * forward / np.linalg.norm(forward)
    return [
        limb(hip, knee, 0.085, T.FABRIC, _DENIM, seed=17),
        limb(knee, ankle, 0.066, T.FABRIC, _DENIM, seed=18),
        limb(
            ankle + np.array([0.0, 0.04, -0.005]),
            ankle + np.array([0.001, -0.13, -0.015]),
            0.055,
            T.PLAIN,
            _SHOE,
            seed=19,
        ),
    ]


def visitor(time: float, cycle: float) -> list[Part]:
    """A cat that rises behind the sofa, looks round and sinks out of sight again, once a cycle."""
    part_of_cycle = (time / cycle) % 1.0
    rise = _ramp((part_of_cycle - 0.12) / 0.22) - _ramp((part_of_cycle - 0.66) / 0.22)
    look = turn("z", 0.5 * math.sin(6.2832 * 2.0 * (part_of_cycle - 0.12)) * rise)
    base = np.array([-0.42, 3.99, 0.18 + 0.70 * rise])
    parts = [ball(_tuple(base + np.array([0.0, 0.0, -0.02])), (0.13, 0.10, 0.20), T.FUR, _GINGER, seed=21)]
    head = base + np.array([0.0, -0.02, 0.24])
    parts.append(ball(_tuple(head), (0.135, 0.115, 0.115), T.FUR, _GINGER, seed=22, rotation=look))
    features = (
        ((0.058, -0.092, 0.030), 0.030, (0.62, 0.80, 0.25), 0.5),
        ((0.062, -0.117, 0.030), 0.014, (0.02, 0.02, 0.02), 0.5),
    )
    for side in (-1.0, 1.0):
        ear = look @ np.array([0.085 * side, 0.0, 0.11])
        tilt = look @ turn("y", 0.35 * side)
        parts.append(ball(_tuple(head + ear), (0.042, 0.025, 0.075), T.FUR, _GINGER, seed=23, rotation=tilt))
        for (x, y, z), radius, tint, gloss in features:
            place = head + look @ np.array([x * side, y, z])
            parts.append(ball(_tuple(place), (radius,) * 3, T.PLAIN, tint, seed=24, rotation=look, gloss=gloss))
    nose = head + look @ np.array([0.0, -0.115, -0.018])
    muzzle = head + look @ np.array([0.0, -0.085, -0.042])
    parts.append(ball(_tuple(nose), (0.018, 0.012, 0.012), T.PLAIN, (0.80, 0.40, 0.40), seed=25, rotation=look))
    parts.append(ball(_tuple(muzzle), (0.062, 0.038, 0.036), T.PLAIN, (0.94, 0.90, 0.84), seed=26, rotation=look))
    return parts


def globe(time: float) -> Part:
    """A globe that turns in place: its texture moves, its outline does not."""
    return ball(
        (1.75, 3.15, 0.82),
        (0.19,) * 3,
        T.GLOBE,
        (1.0, 1.0, 1.0),
        seed=31,
        rotation=turn("y", 0.35) @ turn("z", 0.9 * time),
        gloss=0.15,
    )


def _ramp(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def _tuple(place: Float64) -> tuple[float, float, float]:
    return float(place[0]), float(place[1]), float(place[2])
