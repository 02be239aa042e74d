"""Whole takes at once: the minimum of the twin, and what must not change a track."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import Poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking import take_tracker
from kinedex.ops.tracking.band import assemble, make_band, solve_band
from kinedex.ops.tracking.blocks import TrackProblem, prior_arrays
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.first_track import find_start, first_track
from kinedex.ops.tracking.observations import JointPositions, PriorTerms, Rays, no_priors
from kinedex.ops.tracking.rays import make_evidence
from kinedex.ops.tracking.take_tracker import connected_triples, smoothness_weights, track_take, windows
from tests.ops.tracking.filmed_bodies import BODY, CHAIN, LIMBS, filmed, joint_places, keypoints, moving_poses
from tests.oracles import tracking as oracle
from tests.oracles.kinematic_chain import exp
from tests.plain_python import PLAIN, slow_as_python

POINTS = keypoints()


def moved(poses: Poses, size: float = 0.05, seed: int = 3) -> Poses:
    """Poses beside the given ones, about the axes of the chain."""
    random = np.random.default_rng(seed)
    rotations = poses.rotations.copy()
    for t in range(len(rotations)):
        for axis in CHAIN.axes:
            vector = np.zeros(3)
            vector[axis.direction] = random.normal(0, size)
            rotations[t, axis.node] = rotations[t, axis.node] @ exp(vector)
    return Poses(poses.positions + random.normal(0, size, poses.positions.shape), rotations)


def some_priors(poses: Poses) -> PriorTerms:
    """A term of each kind."""
    priors = no_priors(len(poses.positions), len(CHAIN.nodes))
    priors.turn_weights[1, CHAIN.nodes.index("lshoulder")] = 40.0
    priors.turn_targets[1, CHAIN.nodes.index("lshoulder")] = exp(np.array([0.4, -0.2, 0.3]))
    priors.turn_weights[2, CHAIN.nodes.index("relbow"), 1] = 30.0
    priors.tilt_weights[0] = 50.0
    priors.tilt_targets[0] = np.array([0.1, 0.99, 0.1]) / np.sqrt(0.01 + 0.99**2 + 0.01)
    return PriorTerms(
        priors.turn_targets, priors.turn_weights, priors.tilt_targets, priors.tilt_weights,
        np.array([0, 2]), np.array([CHAIN.joint("ltoes"), CHAIN.joint("rfingers")]),
        np.array([[0, 1.0, 0], [0.6, 0, 0.8]]), np.array([0.05, 0.3]), np.array([900.0, 400.0]),
    )  # fmt: skip


def twin_terms(observations: Rays, poses: Poses, priors: PriorTerms, width: float) -> oracle.Terms:
    depths = [
        oracle.ray_depths(observations, t, oracle.body_points(BODY, POINTS, poses.positions[t], poses.rotations[t]))
        for t in range(len(poses.positions))
    ]  # fmt: skip

    def own(t: int, place: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        points = oracle.body_points(BODY, POINTS, place, rotations)
        return np.concatenate([
            oracle.ray_residuals(observations, t, points, depths[t], 5.0, width),
            oracle.rest_residuals(BODY, rotations),
            oracle.prior_residuals(BODY, priors, t, place, rotations),
        ])  # fmt: skip

    return own


def solved(
    rays: Rays, start: Poses, priors: PriorTerms | None, triples: np.ndarray, *widths: float, sigma_px: float = 5.0
) -> Poses:
    """The minimum, run to convergence."""
    pulls = prior_arrays(BODY, priors, len(start.positions))
    problem = TrackProblem(BODY.arrays, make_evidence(BODY, rays, POINTS, sigma_px), pulls)
    copy = Poses(start.positions.copy(), start.rotations.copy())
    return take_tracker._solve(problem, smoothness_weights(BODY, 30.0), triples, copy, widths, 1e-14, 400)[0]


@slow_as_python
@pytest.mark.parametrize(("width", "cuts"), [(np.inf, ()), (3.0, (2,))])
def test_the_minimum_is_that_of_the_twin(width: float, cuts: tuple[int, ...]) -> None:
    poses = moving_poses(4)
    rays = filmed(poses, POINTS, 0.004)
    priors, triples = some_priors(poses), connected_triples(4, cuts)
    found = solved(rays, moved(poses), priors, triples, width)
    residuals, derivatives = oracle.jacobian(BODY, found, 30.0, triples, twin_terms(rays, found, priors, width))
    step = np.linalg.lstsq(derivatives, -residuals)[0]
    np.testing.assert_allclose(step, 0, atol=1e-5)  # where Gauss and Newton of the twin stay
    problem = TrackProblem(BODY.arrays, make_evidence(BODY, rays, POINTS), prior_arrays(BODY, priors, 4))
    band = make_band(BODY.arrays, np.arange(20), smoothness_weights(BODY, 30.0), triples)
    cost = assemble(problem, *found, width, np.zeros(rays.confidence.shape), True, band)
    assert cost == pytest.approx((residuals**2).sum(), rel=1e-8)


def test_g_and_the_data_part_of_h_are_those_of_the_twin() -> None:
    poses = moving_poses(3)
    rays, priors, triples = filmed(poses, POINTS, 0.004), some_priors(poses), connected_triples(3, ())
    beside = moved(poses)
    band = make_band(BODY.arrays, np.arange(20), smoothness_weights(BODY, 30.0), triples)
    problem = TrackProblem(BODY.arrays, make_evidence(BODY, rays, POINTS), prior_arrays(BODY, priors, 3))
    assemble(problem, *beside, np.inf, np.zeros(rays.confidence.shape), True, band)
    residuals, derivatives = oracle.jacobian(BODY, beside, 30.0, triples, twin_terms(rays, beside, priors, np.inf))
    scale = np.abs(band.gradient).max()
    np.testing.assert_allclose(band.gradient.ravel() / scale, derivatives.T @ residuals / scale, atol=1e-7)
    limbs = [3 + d for d, axis in enumerate(CHAIN.axes) if CHAIN.nodes[axis.node] in ("pelvis", "lhip", "lknee")]
    first = Poses(beside.positions[:1], beside.rotations[:1])
    data = oracle.jacobian(BODY, first, 30.0, np.zeros(1), twin_terms(rays, first, priors, np.inf))[1]
    expected = data.T @ data
    block = np.triu(band.blocks[0]) + np.triu(band.blocks[0], 1).T
    off = ~np.eye(len(limbs), dtype=bool)
    found, twin = block[np.ix_(limbs, limbs)], expected[np.ix_(limbs, limbs)]
    np.testing.assert_allclose(found[off] / scale, twin[off] / scale, atol=1e-6)


@pytest.mark.parametrize("nodes", [(0, 10, 11), tuple(range(20))])
def test_the_solution_of_the_band_is_that_of_the_dense_matrix(nodes: tuple[int, ...]) -> None:
    frames = 3 if PLAIN else 7
    random, triples = np.random.default_rng(0), connected_triples(frames, (2,))
    band = make_band(BODY.arrays, np.array(nodes), random.uniform(1, 3, 48), triples)
    m, size = len(band.coupled), 48
    dense = np.zeros((frames, size, frames, size))
    for t in range(frames):
        factor = random.normal(size=(m, m))
        band.blocks[t] = np.triu(factor @ factor.T)
        band.diagonals[t] = random.uniform(1, 2, size)
        band.diagonals[t, band.coupled] = np.diag(factor @ factor.T)
        own = np.diag(band.diagonals[t])
        own[np.ix_(band.coupled, band.coupled)] = factor @ factor.T
        dense[t, :, t, :] += own
        for d, (one, two) in enumerate([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]):
            if triples[t]:
                w = (1, -2, 1)[d // 3] * (1, -2, 1)[d % 3] * band.smoothness
                dense[t + one, np.arange(size), t + two, np.arange(size)] += w
    band.gradient[:] = random.normal(size=(frames, size))
    matrix = dense.reshape(frames * size, -1)
    matrix += np.diag(0.01 * np.diag(matrix) + 1e-6)
    steps = np.empty((frames, size))
    solve_band(band, 0.01, np.empty((frames, m, 2 * m + 1)), steps)
    np.testing.assert_allclose(steps.ravel(), np.linalg.solve(matrix, -band.gradient.ravel()), atol=1e-9)


@slow_as_python
def test_exact_rays_give_the_limbs_back() -> None:
    poses = moving_poses(20)
    rays = filmed(poses, POINTS)
    start = find_start(BODY, rays, POINTS)
    track = solved(rays, start, None, connected_triples(20, ()), np.inf, 12.0, 3.0, sigma_px=0.05)
    assert np.abs(joint_places(track) - joint_places(poses))[:, LIMBS].max() < 1e-4


@slow_as_python
def test_a_turned_world_turns_the_track() -> None:
    poses = moving_poses(12)
    rays = filmed(poses, POINTS, 0.003)
    turn = exp(np.array([0, 1.1, 0]))
    other = type(rays)(rays.centres @ turn.T, rays.focal_px, rays.directions @ turn.T, rays.confidence)
    first, second = (first_track(Observed(BODY, 30.0, one, POINTS)).track for one in (rays, other))
    np.testing.assert_allclose(second.positions, first.positions @ turn.T, atol=1e-6)
    np.testing.assert_allclose(second.costs, first.costs, rtol=1e-6)


@slow_as_python
def test_the_same_input_gives_the_same_bytes_and_weightless_priors_change_nothing() -> None:
    poses = moving_poses(12)
    rays = filmed(poses, POINTS, 0.003)
    start = find_start(BODY, rays, POINTS)
    none = no_priors(12, 20)
    tracks = [track_take(Observed(BODY, 30.0, rays, POINTS), start, priors) for priors in (None, None, none)]
    assert len({track.positions.tobytes() + track.poses.rotations.tobytes() for track in tracks}) == 1


@slow_as_python
def test_nothing_goes_across_a_cut() -> None:
    poses = moving_poses(16)
    rays = filmed(poses, POINTS, 0.003)
    start = find_start(BODY, rays, POINTS)
    whole = solved(rays, start, None, connected_triples(16, (8,)), 3.0)
    for part in (slice(0, 8), slice(8, 16)):
        own = type(rays)(rays.centres, rays.focal_px, rays.directions[part], rays.confidence[part])
        alone = solved(own, Poses(start.positions[part], start.rotations[part]), None, connected_triples(8, ()), 3.0)
        np.testing.assert_allclose(joint_places(alone), joint_places(whole)[part], atol=1e-6)


@slow_as_python
def test_windows_give_the_track_of_the_whole_take(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = moving_poses(200)
    rays = filmed(poses, POINTS, 0.003)
    start = find_start(BODY, rays, POINTS)
    whole = track_take(Observed(BODY, 30.0, rays, POINTS), start)
    monkeypatch.setattr(take_tracker, "WINDOW_FRAMES", 110)
    parts = track_take(Observed(BODY, 30.0, rays, POINTS), start)
    assert np.abs(parts.positions - whole.positions)[:, LIMBS].max() < 1e-4


def test_windows_cover_every_frame_once() -> None:
    for frames in (1, 1999, 2000, 2001, 2031, 3940, 3941, 12345):
        found = windows(frames)
        assert [low for _, _, low, _ in found] == [0, *(high for *_, high in found[:-1])]
        assert found[-1][3] == frames
        assert all(first <= low < high <= stop <= first + 2000 for first, stop, low, high in found)


def test_three_frames_of_a_3d_track_come_nearer_to_it() -> None:
    poses = moving_poses(3)
    positions = joint_places(poses)
    observed = JointPositions(
        positions + np.random.default_rng(0).normal(0, 0.01, positions.shape), np.full((3, 24), 0.02)
    )
    observed.positions[:, [joint for joint in range(24) if joint not in LIMBS[:3]]] = np.nan
    start = moved(poses, 0.02)
    track = track_take(Observed(BODY, 30.0, observed), start, schedule=(3.0,))
    before = ((joint_places(start) - observed.positions)[:, LIMBS[:3]] ** 2).sum()
    assert ((track.positions - observed.positions)[:, LIMBS[:3]] ** 2).sum() < 0.5 * before


def test_what_cannot_be_tracked_is_refused() -> None:
    poses = moving_poses(2)
    rays = filmed(poses, POINTS)
    for arguments, message in (
        ({"rate_hz": 0.0}, "rate_hz must be positive"),
        ({"loss": "huber"}, "loss must be geman_mcclure or squares"),
        ({"schedule": ()}, "schedule must be positive numbers"),
        ({"cuts": (2,)}, "cuts must be frames from 0 to 1"),
        ({"start": moving_poses(3)}, "start must be a pose for each of the 2 frames"),
        ({"priors": no_priors(3, 20)}, "priors must be terms of 2 frames and 20 nodes"),
    ):
        observed = Observed(BODY, arguments.pop("rate_hz", 30.0), rays, POINTS, cuts=arguments.pop("cuts", ()))
        with pytest.raises(ParameterError, match=message):
            track_take(observed, **({"start": poses} | arguments))  # type: ignore[arg-type]
