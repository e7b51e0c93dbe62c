"""How a step's numbers lie in memory, and the structures that its kernels share."""

from __future__ import annotations

import warp as wp

from streamlod.core.scene.anchors import FEATURE_LATENTS, HIDDEN, LATENTS
from streamlod.core.scene.quantise import DEFAULT_OFFSET

LATENT_COUNT = wp.constant(LATENTS)
NUMBERS = wp.constant(LATENTS + 3)  # of an anchor that are trained: latents, then steps along the three axes
HIDDEN_UNITS = wp.constant(HIDDEN)
DEAD_ZONE = wp.constant(DEFAULT_OFFSET)

# What a step is told, in float32: learning rates over Adam's first correction, one over its second, one minus both
# betas, weight of this step in the mean, weight of a bit, share of D-SSIM; of new anchors the rates of features,
# offsets, scalings and places over Adam's first correction, and one over its second; place where the loss is written.
RATE_LATENT, RATE_POSITION, INVERSE_SECOND = (wp.constant(k) for k in range(3))
NEWS_FIRST, NEWS_SECOND, MEAN_WEIGHT, PRICE = (wp.constant(k) for k in range(3, 7))
DSSIM_WEIGHT, NEW_RATES, NEW_INVERSE_SECOND, PLACE = wp.constant(7), wp.constant(8), wp.constant(12), wp.constant(13)
TOLD = 14

# What a step adds up: quantised magnitudes of all latents and of all positions, loss of the pictures, bits.
SUM_LATENTS, SUM_POSITIONS, SUM_LOSS, SUM_BITS = (wp.constant(k) for k in range(4))
TOTALS = 4

vec12 = wp.types.vector(FEATURE_LATENTS, float)


@wp.struct
class AnchorBase:
    """Anchors as they were before the frame; N is a capacity, K the Gaussians of an anchor.

    Attributes:
        count: [1] anchors that exist.
        hidden: [N,32] what the network's hidden units get from the feature, bias included, before activation.
        offset: [N,K]. offset_size, scale_size: [N] exp of both halves of the scaling.
        node: [N] world positions. step: [N] world units of a position's step.
        steps_a_pixel: [N] positions are trained in pixels, and sent in steps.
    """

    count: wp.array[int]
    hidden: wp.array2d[float]
    offset: wp.array2d[wp.vec3]
    offset_size: wp.array[wp.vec3]
    scale_size: wp.array[wp.vec3]
    node: wp.array[wp.vec3]
    step: wp.array[float]
    steps_a_pixel: wp.array[float]


@wp.struct
class Decoders:
    """The network and the latents' decoders, folded: features appear nowhere.

    Attributes:
        latent: [32] what each feature latent adds to a hidden unit. view: [32] what the view adds.
        offset: [12,K] what each offset latent adds to an offset.
        opacity, colour, scale, rotation: [33,K] of the hidden units, and the bias as the last row.
        centre: [C] of the cameras. distance: [1] the reference distance, 0 where the network does not see the view.
    """

    latent: wp.array[vec12]
    view: wp.array[wp.vec4]
    offset: wp.array2d[wp.vec3]
    opacity: wp.array2d[float]
    colour: wp.array2d[wp.vec3]
    scale: wp.array2d[wp.vec3]
    rotation: wp.array2d[wp.vec4]
    centre: wp.array[wp.vec3]
    distance: wp.array[float]


@wp.func
def dead_zone(value: float) -> float:
    """The integer that a value is sent as (`core.scene.quantise`)."""
    size = wp.floor(wp.abs(value) + DEAD_ZONE)
    return wp.where(value < 0.0, -size, size)


@wp.func
def integers(values: wp.array[float], first: int) -> vec12:
    """Twelve latents as they are sent."""
    z = vec12()
    for k in range(12):
        z[k] = dead_zone(values[first + k])
    return z


@wp.func
def going(values: wp.array[float], base: AnchorBase, a: int) -> wp.vec3:
    """Steps that an anchor goes."""
    first = a * NUMBERS + LATENT_COUNT
    return wp.vec3(values[first], values[first + 1], values[first + 2]) * base.steps_a_pixel[a]


@wp.func
def seen_from(decoders: Decoders, place: wp.vec3, c: int) -> wp.vec4:
    """What the network sees of a camera: direction and relative distance; zeros where it sees nothing."""
    view = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if decoders.distance[0] > 0.0:
        away = place - decoders.centre[c]
        distance = wp.max(wp.length(away), 1.0e-12)
        view = wp.vec4(away[0] / distance, away[1] / distance, away[2] / distance, distance / decoders.distance[0])
    return view


@wp.func
def hidden_unit(base: AnchorBase, decoders: Decoders, a: int, j: int, z: vec12, view: wp.vec4) -> float:
    """One hidden unit before activation."""
    return base.hidden[a, j] + wp.dot(decoders.latent[j], z) + wp.dot(decoders.view[j], view)
