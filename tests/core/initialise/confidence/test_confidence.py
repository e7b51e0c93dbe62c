"""What speaks for a depth, and what the network makes of it."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest

from streamlod.core.arrays import Float32
from streamlod.core.camera import look_at, pinhole
from streamlod.core.initialise import first_points
from streamlod.core.initialise.confidence.evidence import CUES, Matches, evidence
from streamlod.core.initialise.confidence.gaps import in_gaps
from streamlod.core.initialise.confidence.network import Confidence, usual_confidence
from streamlod.core.initialise.methods.learned import believed
from streamlod.core.initialise.methods.plane_sweep import swept
from streamlod.core.initialise.stereo.patch_kernel import UNSEEN
from streamlod.core.initialise.stereo.patches import SlantedMap
from streamlod.core.initialise.views import WorkingViews, working_views
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic
from tests.core.initialise.stereo.test_patches import BOUNDS, floor_picture
from tests.core.initialise.stereo.test_patches import camera as floor_camera

SIDE = 24
UP = np.array([0.0, 0.0, 1.0])


def wall_map(x: float, depth: float) -> SlantedMap:
    """A camera at (x, -1, 0) that looks along y and sees a wall across, `depth` before it."""
    eye = np.array([x, -1.0, 0.0])
    camera = pinhole(f"{x}", (SIDE, SIDE), (12, 12), (SIDE, SIDE), look_at(eye, eye + np.array([0.0, 1.0, 0.0]), UP))
    planes = np.zeros((SIDE, SIDE, 3))
    planes[..., 0] = 1 / depth
    full = np.full((SIDE, SIDE), depth, np.float32)
    return SlantedMap(camera, full, np.full_like(full, 0.1), planes, np.full_like(full, 0.3))


def matches_of(*maps: SlantedMap) -> Matches:
    images = np.full((len(maps), SIDE, SIDE, 3), 0.5, np.float32)
    trusted = [np.ones((SIDE, SIDE), np.bool_) for _ in maps]
    return Matches(WorkingViews(tuple(one.camera for one in maps), images), maps, maps, trusted)


def middle(matches: Matches) -> dict[str, float]:
    """The cues of the first view's middle pixel."""
    values = evidence(matches)[0].reshape(SIDE, SIDE, len(CUES))[SIDE // 2, SIDE // 2]
    return dict(zip(CUES, values.tolist(), strict=True))


def test_views_of_one_wall_speak_for_each_other() -> None:
    cues = middle(matches_of(wall_map(0, 2.0), wall_map(0.1, 2.0), wall_map(-0.1, 2.0)))
    assert cues["least difference to a view"] == pytest.approx(0, abs=1e-6)
    assert cues["cosine between normals there"] == pytest.approx(1)
    assert (cues["views that agree"], cues["views that agree in normal too"], cues["views that see it"]) == (2, 2, 2)
    assert (cues["views that look through"], cues["views that look through at trusted pixels"]) == (0, 0)
    assert (cues["second plane residual"], cues["texture"], cues["depth"]) == (0, 0, 0)
    assert (cues["cosine of the viewing angle"], cues["neighbours with agreement"]) == (pytest.approx(1, abs=1e-3), 1)
    assert cues["parallax"] == pytest.approx(np.log(0.1 * SIDE / 2.0))


def test_views_that_look_through_speak_against_it_and_trusted_ones_twice() -> None:
    matches = matches_of(wall_map(0, 1.0), wall_map(0.1, 2.0), wall_map(-0.1, 2.0))
    cues = middle(matches)
    assert (
        cues["views that agree"],
        cues["views that look through"],
        cues["views that look through at trusted pixels"],
    ) == (0, 2, 2)
    assert cues["least difference to a view"] == pytest.approx(0.2)  # as much as counts
    unsure = replace(matches, trusted=[matches.trusted[0], *(np.zeros((SIDE, SIDE), np.bool_) for _ in range(2))])
    assert middle(unsure)["views that look through at trusted pixels"] == 0


def test_a_slanted_neighbour_has_another_normal() -> None:
    tilted = wall_map(0.1, 2.0)
    planes = tilted.planes.copy()
    planes[..., 1] = 0.02  # a pixel to the right; the middle keeps its depth
    cues = middle(matches_of(wall_map(0, 2.0), replace(tilted, planes=planes)))
    assert cues["views that agree"] == 1
    assert cues["views that agree in normal too"] == 0


def test_nothing_trusted_is_evidence_as_well() -> None:
    matches = matches_of(wall_map(0, 2.0), wall_map(0.1, 2.0))
    nothing = replace(matches, trusted=[np.zeros((SIDE, SIDE), np.bool_)] * 2)
    assert all(np.isfinite(values).all() for values in evidence(nothing))


def test_two_views_are_left_to_the_tests() -> None:
    matches = matches_of(wall_map(0, 2.0), wall_map(0.1, 2.0))
    assert all(a is b for a, b in zip(believed(matches), matches.trusted, strict=True))


def test_only_the_nearest_views_are_asked() -> None:
    """Views beyond the seventh change nothing, so that many do not agree by chance."""
    walls = [wall_map(0.1 * number, 2.0) for number in range(8)]
    far = [wall_map(0.8 + 0.1 * number, 1.0) for number in range(4)]
    np.testing.assert_array_equal(evidence(matches_of(*walls, *far))[0], evidence(matches_of(*walls))[0])


def untrusted(matches: Matches) -> Matches:
    return replace(matches, trusted=[np.zeros_like(good) for good in matches.trusted])


def test_depths_that_cannot_be_told_are_never_believed() -> None:
    maps = [wall_map(x, 2.0) for x in (0, 0.1, -0.1)]
    assert np.stack(believed(untrusted(matches_of(*maps)), 0.0)).mean() > 0.9
    hopeless = [replace(one, margin=np.full_like(one.margin, -UNSEEN)) for one in maps]
    assert not np.stack(believed(untrusted(matches_of(*hopeless)), 0.0)).any()


def test_what_passes_the_tests_stays_whatever_the_network_says() -> None:
    matches = matches_of(*(wall_map(x, 2.0) for x in (0, 0.1, -0.1)))
    assert np.stack(believed(matches, 1.0)).all()


def test_a_depth_needs_another_view_that_agrees_and_fewer_that_look_through() -> None:
    alone = untrusted(matches_of(wall_map(0, 1.0), wall_map(0.1, 2.0), wall_map(-0.1, 2.0)))
    near, *far = believed(alone, 0.0)
    assert not near[8:16, 8:16].any()
    assert all(one[8:16, 8:16].all() for one in far)
    twice = untrusted(matches_of(wall_map(0, 1.0), wall_map(0.1, 1.0), wall_map(-0.1, 2.0)))
    assert not np.stack(believed(twice, 0.0))[:, 8:16, 8:16].any()  # one for it, one against


def test_a_witness_needs_witnesses_itself() -> None:
    """The first agrees with the second alone, which the third looks through; nothing agrees with the third."""
    chain = untrusted(matches_of(wall_map(0, 2.06), wall_map(0.1, 2.03), wall_map(-0.1, 2.12)))
    assert not np.stack(believed(chain, 0.0))[:, 8:16, 8:16].any()


def test_the_network_is_asked_in_gaps_alone() -> None:
    matches = matches_of(*(wall_map(x, 2.0) for x in (0, 0.1, -0.1)))
    nothing = np.zeros((SIDE, SIDE), np.bool_)
    covered = replace(matches, trusted=[nothing, *matches.trusted[1:]])
    assert not believed(covered, 0.0)[0][8:16, 8:16].any()


@pytest.mark.parametrize(("depth", "gap"), [(2.0, False), (1.0, False), (2.06, False), (2.2, True)])
def test_trusted_surfaces_leave_a_gap_behind_them_alone(depth: float, gap: bool) -> None:
    maps = [wall_map(0, depth), wall_map(0.1, 2.0), wall_map(-0.1, 2.0)]
    nothing, all_of_it = np.zeros((SIDE, SIDE), np.bool_), np.ones((SIDE, SIDE), np.bool_)
    assert (in_gaps(maps, [nothing, all_of_it, all_of_it])[0][8:16, 8:16] == gap).all()
    assert (in_gaps(maps, [nothing, nothing, all_of_it])[0][8:16, 8:16] == gap).all()
    assert in_gaps(maps, [all_of_it, nothing, nothing])[0].all()  # its own view is not asked


@pytest.mark.long
def test_noise_on_a_plain_floor_is_not_believed() -> None:
    """By chance some depth agrees with some view at every pixel."""
    generator, cameras = np.random.default_rng(0), tuple(floor_camera(x) for x in np.linspace(-0.5, 0.5, 8))
    pictures = np.stack([floor_picture(camera, 0.02) for camera in cameras])
    noisy = np.clip(pictures + generator.normal(0, 0.01, pictures.shape), 0, 1).astype(np.float32)
    matches = swept(WorkingViews(cameras, noisy), BOUNDS)
    assert np.stack(believed(matches)).mean() < 0.01


def test_the_weights_belong_to_these_cues() -> None:
    with (
        (files("streamlod.core.initialise.confidence") / "network.npz").open("rb") as file,
        np.load(file, allow_pickle=False) as arrays,
    ):
        assert tuple(arrays["cues"]) == CUES


def reference(network: Confidence, cues: Float32) -> float:
    """One pixel, number by number."""
    values = [
        min(max((float(c) - float(m)) / float(d), -4.0), 4.0)
        for c, m, d in zip(cues, network.mean, network.deviation, strict=True)
    ]
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        sums = [
            float(bias[n]) + sum(v * float(w) for v, w in zip(values, weight[:, n], strict=True))
            for n in range(len(bias))
        ]
        values = [float(np.tanh(s)) for s in sums] if layer < 2 else sums
    return 1 / (1 + float(np.exp(-values[0])))


def test_the_network_is_that_of_the_reference_and_bears_the_extremes() -> None:
    network = usual_confidence()
    shapes = [len(CUES), *(len(bias) for bias in network.biases)]
    assert [weight.shape for weight in network.weights] == list(pairwise(shapes))
    cues = np.random.default_rng(0).normal(0, 3, (20, len(CUES))).astype(np.float32)
    np.testing.assert_allclose(network(cues), [reference(network, row) for row in cues], atol=1e-5)
    extreme = network(np.array([[np.inf] * len(CUES), [-np.inf] * len(CUES), [1e30] * len(CUES)], np.float32))
    assert np.isfinite(extreme).all()


@pytest.mark.long
def test_it_finds_more_right_depths_than_the_tests_alone() -> None:
    """A kind of room that it knows, with other textures, and three cameras far apart; of as many, fewer are wrong."""
    spec = SyntheticSpec(kind="bright", cameras=3, frames=1, width=160, height=90, seed=5)
    dataset = open_synthetic(spec)
    views = working_views(next(iter(dataset.frames())), dataset.cameras, 90)
    matches = swept(views, dataset.depth_bounds)
    network = usual_confidence()
    confidence = np.concatenate([network(values) for values in evidence(matches)])
    taken = np.concatenate([good.ravel() for good in believed(matches)])
    trusted = np.concatenate([good.ravel() for good in matches.trusted])
    truth = [ground_truth(spec, 0, number).depth for number in range(3)]
    pairs = zip(matches.maps, truth, strict=True)
    right = np.concatenate([(np.abs(one.depth / true - 1) < 0.03).ravel() for one, true in pairs])
    surest = confidence >= np.sort(confidence)[-trusted.sum()]  # as many as pass the tests
    assert right[taken].sum() > 1.1 * right[trusted].sum()
    added = taken & ~trusted
    assert added.sum() > 0.1 * trusted.sum()  # in gaps: what has points already needs no more
    assert right[added].mean() >= right[trusted].mean() - 0.02
    assert right[surest].mean() >= right[trusted].mean()


@pytest.mark.long
def test_first_points_are_what_is_believed() -> None:
    spec = SyntheticSpec(kind="bright", cameras=3, frames=1, width=80, height=45, seed=5)
    dataset = open_synthetic(spec)
    frame, bounds = next(iter(dataset.frames())), dataset.depth_bounds
    matches = swept(working_views(frame, dataset.cameras, spec.height), bounds)
    taken, trusted = (np.stack(good).sum() for good in (believed(matches), matches.trusted))
    assert taken > trusted
    learned = first_points(frame, dataset.cameras, depth_bounds=bounds, method="learned")
    assert len(learned) == taken
    usual = first_points(frame, dataset.cameras, depth_bounds=bounds)  # gaps that remain are left to training
    np.testing.assert_array_equal(usual.positions, learned.positions)
