"""Time the parts of a depth frame: fits and costs of poses, beside dense linear algebra of the same size.

The frame is one of a take of the synthetic archive before the simulated time-of-flight camera; the pose is the one of
two frames before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.harness import Figure, seconds, sized
from kinedex.catalog.filmed_bodies import load_filmed_body
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.image_search import depth_view
from kinedex.ops.depth.points import FrameCloud, Preparation, ray_table
from kinedex.ops.depth.pose_fit import RETRIEVED_SIGMA_M, SAMPLED_POINTS, STEPS, PoseFit, cost_of
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from kinedex.ops.simulation.depth_sensors import SENSORS, UNIT_M
from kinedex.pipelines.simulation.simulated_depth import film_take
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

FRAME, BEFORE = 20, 18
"""The frame, and the one whose true pose fits begin with."""

RUNS = sized(60, 2)
"""Runs of a part, of which the best counts; each takes less than a millisecond."""


class Filmed(NamedTuple):
    """A frame of a simulated recording: its image, points, fit, and the true pose of an earlier frame."""

    image: npt.NDArray[np.float32]
    preparation: Preparation
    cloud: FrameCloud
    fit: PoseFit
    pose: F64


def figures(store: Store) -> list[Figure]:
    """Time the parts of a frame."""
    return fit_figures(filmed_frame(store))


def filmed_frame(store: Store) -> Filmed:
    """Film a frame of the longest take."""
    sensor, body = SENSORS["tof"], load_filmed_body("first")
    takes = store.takes().sort("frames", "name", descending=[True, False])
    positions = joint_positions(store.frames(takes["name"][0]).combine_chunks(), JOINTS)
    joints = np.ascontiguousarray(positions.transpose(2, 0, 1)[: FRAME + 1], np.float64)
    lengths = bone_lengths_of(joints)
    filmed = film_take(sensor, body, joints, lengths, 0.0, [1])
    background = (filmed.scene.background() * UNIT_M).astype(np.float32)
    image = (filmed.scene.frame(FRAME) * UNIT_M).astype(np.float32)
    preparation = Preparation(ray_table(sensor.matrix, (), sensor.size), background)
    fit = PoseFit(body.body, body.body.standing_height(lengths), depth_view(sensor.matrix))
    cloud = preparation.prepare(image)
    fit.look(cloud)
    pose = filmed.place.seen(filmed.joints[BEFORE]) * np.array([1.0, -1.0, -1.0])
    return Filmed(image, preparation, cloud, fit, np.ascontiguousarray(pose))


def fit_figures(filmed: Filmed) -> list[Figure]:
    """Time fits and costs of a pose, and the dense equations that a fit does without."""
    fit, out = filmed.fit, np.empty_like(filmed.pose)
    extrema = np.ascontiguousarray(filmed.cloud.points[::200][:20])
    local = seconds(lambda: fit.fit(filmed.pose, out=out), RUNS)
    trial = seconds(lambda: fit.fit(filmed.pose, 2, (RETRIEVED_SIGMA_M[0],) * 2, out=out), RUNS)
    cost = seconds(lambda: cost_of(fit, filmed.pose, extrema), RUNS)
    dense = _dense_step(3 * len(fit.body.pivots.joints) + 3)
    return [
        Figure(
            f"local optimisation, at most {STEPS} steps", 1.0, "poses", local,
            f"BLAS and LAPACK: {STEPS} × JᵀJ of {SAMPLED_POINTS} rows and its solution", STEPS * dense,
        ),
        Figure(
            "candidate of the database, 2 steps", 1.0, "poses", trial,
            f"BLAS and LAPACK: 2 × JᵀJ of {SAMPLED_POINTS} rows and its solution", 2 * dense,
        ),
        Figure("cost of a pose in the vote", 1.0, "poses", cost, "local optimisation", local),
    ]  # fmt: skip


def _dense_step(unknowns: int) -> float:
    """Time JᵀJ and the solution of a step by numpy, with all rows at hand."""
    generator = np.random.default_rng(1)
    rows, residuals = generator.standard_normal((SAMPLED_POINTS, unknowns)), generator.standard_normal(SAMPLED_POINTS)
    return seconds(lambda: np.linalg.solve(rows.T @ rows, rows.T @ residuals), RUNS)
