"""Time tracking: a Gauss–Newton pass beside LAPACK's banded Cholesky of the same matrix, and tracks beside recordings.

The recordings are simulated from takes of the synthetic archive: four cameras, COCO's keypoints and big toes, noise,
outliers and failures. A pass is one step of Levenberg's method: H and g of all frames, the solution of the system, new
poses and their cost. LAPACK's time is that of `scipy.linalg.cholesky_banded` alone, on one core.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.harness import Figure, seconds, sized
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.cameras.projection import camera_centre, pixel_directions
from kinedex.ops.simulation.recording import Setup, simulated_recording, take_generators
from kinedex.ops.tracking.band import Band, assemble, make_band, move, solve_band, take_cost
from kinedex.ops.tracking.blocks import TrackProblem, prior_arrays
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.first_track import find_start, first_track
from kinedex.ops.tracking.observations import BodyPoints, Rays
from kinedex.ops.tracking.rays import make_evidence
from kinedex.ops.tracking.take_tracker import connected_triples, smoothness_weights, track_take
from kinedex.pipelines.simulation.simulated_cameras import limbs_of
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

FRAMES, PASS_FRAMES, TIMES = *sized((400, 100), (80, 20)), 4
"""Frames of the recording, those of a pass, and how many times as many a long pass has."""

RUNS = sized(40, 2)
"""Runs of a pass, of which the best counts; each takes milliseconds."""

RECORDED_HZ = 60.0
WIDTH, DAMPING = 3.0, 1e-3


def figures(store: Store) -> list[Figure]:
    """Time a pass, a first track, and the growth of a pass with the frames."""
    body, points, rays = recording(store, FRAMES)
    rate_hz, start = store.rate_hz, find_start(body, rays, points)
    short, short_work = gauss_newton_pass(body, points, _part(rays, PASS_FRAMES), rate_hz, _poses(start, PASS_FRAMES))
    _, long_work = gauss_newton_pass(body, points, rays, rate_hz, start)
    short_s, long_s = seconds(short_work, RUNS), seconds(long_work, RUNS)
    lapack, reason = _lapack(short)
    observed = Observed(body, rate_hz, rays, points)
    solve = seconds(lambda: track_take(observed, start), 3)
    first = seconds(lambda: first_track(observed), 3)
    recorded = f"the recording at {RECORDED_HZ:g} Hz"
    return [
        Figure(
            f"Gauss–Newton pass, {PASS_FRAMES} frames, 4 cameras", PASS_FRAMES, "frames", short_s,
            reason or "LAPACK's banded Cholesky of its matrix", lapack,
        ),
        Figure(
            "solution of its system alone", PASS_FRAMES, "frames", seconds(_solution(short), RUNS),
            reason or "LAPACK's banded Cholesky", lapack,
        ),
        Figure(
            f"Gauss–Newton pass, {FRAMES} frames", FRAMES, "frames", long_s,
            f"{TIMES} passes over {PASS_FRAMES}", TIMES * short_s,
        ),
        Figure("first solve of a take", FRAMES, "frames", solve, recorded, FRAMES / RECORDED_HZ),
        Figure("start, solve, restart, solve", FRAMES, "frames", first, recorded, FRAMES / RECORDED_HZ),
    ]  # fmt: skip


def _part(rays: Rays, frames: int) -> Rays:
    return replace(rays, directions=rays.directions[:frames], confidence=rays.confidence[:frames])


def _poses(poses: Poses, frames: int) -> Poses:
    return Poses(poses.positions[:frames], poses.rotations[:frames])


def recording(store: Store, frames: int) -> tuple[ChainBody, BodyPoints, Rays]:
    """Film the first frames of the longest take."""
    takes = store.takes().sort("frames", "name", descending=[True, False])
    chain, keypoints = load_kinematic_chain(), load_keypoint_set("coco-17-toes")
    positions = np.asarray(joint_positions(store.frames(takes["name"][0]).combine_chunks(), chain.joints), np.float64)
    positions = np.ascontiguousarray(positions[:, :, :frames])
    body = measured_body(chain, positions)
    points, setup = keypoints.body_points(keypoints.order, body), Setup()
    made = simulated_recording(
        setup, body, positions, points, limbs_of(keypoints), store.rate_hz, take_generators(1, "benchmark")
    )
    directions = np.stack([
        pixel_directions(setup.ring.matrix, turn, (), made.pixels[:, v]) for v, turn in enumerate(made.rotations)
    ], axis=1)  # fmt: skip
    centres = np.stack([camera_centre(*one) for one in zip(made.rotations, made.translations, strict=True)])
    focal = np.full(len(centres), 0.5 * (setup.ring.matrix[0, 0] + setup.ring.matrix[1, 1]))
    return body, points, Rays(centres, focal, directions, made.confidence)


def gauss_newton_pass(
    body: ChainBody, points: BodyPoints, rays: Rays, rate_hz: float, start: Poses
) -> tuple[Band, Callable[[], object]]:
    """Return the system of a take at its start, and the work of one pass."""
    frames, evidence = len(start.positions), make_evidence(body, rays, points)
    problem = TrackProblem(body.arrays, evidence, prior_arrays(body, None, frames))
    units = np.zeros(rays.confidence.shape)
    band = make_band(
        body.arrays, np.unique(evidence.nodes), smoothness_weights(body, rate_hz), connected_triples(frames, ())
    )
    steps, trial = np.empty_like(band.gradient), Poses(np.empty_like(start.positions), np.empty_like(start.rotations))
    factors = np.empty((frames, len(band.coupled), 2 * len(band.coupled) + 1))

    def work() -> float:
        assemble(problem, *start, WIDTH, units, True, band)
        solve_band(band, DAMPING, factors, steps)
        move(body.arrays, *start, steps, *trial)
        return take_cost(problem, *trial, WIDTH, units, band)

    work()
    return band, work


def _solution(band: Band) -> Callable[[], object]:
    steps = np.empty_like(band.gradient)
    factors = np.empty((len(steps), len(band.coupled), 2 * len(band.coupled) + 1))
    return lambda: solve_band(band, DAMPING, factors, steps)


def _lapack(band: Band) -> tuple[float | None, str]:
    """Time LAPACK's factorisation of the matrix of a system, or return the reason why nothing was timed."""
    try:
        from scipy.linalg import cholesky_banded
    except ModuleNotFoundError:
        return None, "LAPACK was not timed: scipy is not installed (make bench installs it)"
    matrix = banded(band)
    return seconds(lambda: cholesky_banded(matrix, lower=True, check_finite=False), RUNS), ""


def banded(band: Band) -> np.ndarray:
    """Return the damped matrix of a system in LAPACK's lower banded form."""
    frames, size = band.diagonals.shape
    matrix = np.zeros((2 * size + 1, frames * size))
    lower = matrix.reshape(2 * size + 1, frames, size)
    for a, i in enumerate(band.coupled):
        for b in range(a + 1, len(band.coupled)):
            lower[band.coupled[b] - i, :, i] = band.blocks[:, a, b]
    inner = np.concatenate([[0.0], band.triples, [0.0, 0.0]])  # 0 beyond both ends
    before, here, after = inner[:frames], inner[1 : frames + 1], inner[2 : frames + 2]
    diagonal = band.diagonals + (before + 4.0 * here + after)[:, None] * band.smoothness
    lower[0] = (1.0 + DAMPING) * diagonal + 1e-6
    lower[size] = -2.0 * (here + after)[:, None] * band.smoothness
    lower[2 * size] = after[:, None] * band.smoothness
    return matrix
