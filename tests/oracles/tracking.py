"""Tracking as its definition has it: every term as a plain residual, of all frames in one vector."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, PriorTerms, Rays
from tests.oracles.kinematic_chain import joints, log, stepped


def body_points(body: ChainBody, points: BodyPoints, place: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """The points (P, 3) of one pose."""
    chain = body.chain
    world, centres = [], []
    for k, parent in enumerate(chain.parents):
        world.append(rotations[k] if parent < 0 else world[parent] @ rotations[k])
        offset = body.offsets[chain.centres[k]]
        centres.append(place if parent < 0 else centres[parent] + world[parent] @ offset)
    return np.array([
        centres[node] + world[node] @ offset for node, offset in zip(points.nodes, points.offsets, strict=True)
    ])  # fmt: skip


def ray_depths(rays: Rays, t: int, positions: np.ndarray) -> np.ndarray:
    """The depths (V, P) of points in the cameras."""
    gaps = positions[None] - rays.centres[:, None]
    return np.maximum(0.3, (gaps * rays.directions[t]).sum(axis=2))


def ray_residuals(
    rays: Rays, t: int, positions: np.ndarray, depths: np.ndarray, sigma_px: float, width: float
) -> np.ndarray:
    """The residuals of all rays of a frame: conf · e / (depth · σ_px / f) / √(1 + r²/c²)."""
    gaps = positions[None] - rays.centres[:, None]
    n = rays.directions[t]
    e = gaps - (gaps * n).sum(axis=2, keepdims=True) * n
    e = e / (depths * sigma_px / rays.focal_px[:, None])[:, :, None]
    square = (e**2).sum(axis=2, keepdims=True)
    confidence = np.where(rays.confidence[t] >= 0.1, rays.confidence[t], 0.0)[:, :, None]
    return (confidence * e / np.sqrt(1 + square / width**2)).ravel()


def place_residuals(observed: JointPositions, t: int, positions: np.ndarray, width: float) -> np.ndarray:
    """The residuals of the places of a frame."""
    e = np.nan_to_num((positions - observed.positions[t]) / observed.sigma_m[t][:, None])
    return (e / np.sqrt(1 + (e**2).sum(axis=1, keepdims=True) / width**2)).ravel()


def rest_residuals(body: ChainBody, rotations: np.ndarray) -> np.ndarray:
    """The pulls to rest and the hinges of a frame."""
    logs = [log(turn) for turn in rotations]
    found = []
    for axis in body.chain.axes:
        turn = axis.sign * logs[axis.node][axis.direction]
        found += [turn / axis.pull, (turn - np.clip(turn, *axis.hinge)) / 0.05]
    return np.array(found)


def prior_residuals(
    body: ChainBody, priors: PriorTerms, t: int, place: np.ndarray, rotations: np.ndarray
) -> np.ndarray:
    """The terms of priors of a frame."""
    found = []
    for axis in body.chain.axes:
        vector = log(priors.turn_targets[t, axis.node].T @ rotations[axis.node])
        found.append(np.sqrt(priors.turn_weights[t, axis.node, axis.direction]) * vector[axis.direction])
    found += list(np.sqrt(priors.tilt_weights[t]) * (rotations[0].T @ [0, 1, 0] - priors.tilt_targets[t]))
    at = joints(body, place, rotations)
    for n in np.flatnonzero(priors.place_frames == t):
        excess = priors.place_directions[n] @ at[priors.place_joints[n]] - priors.place_targets[n]
        found.append(np.sqrt(priors.place_weights[n]) * excess)
    return np.array(found)


def difference_residuals(body: ChainBody, poses: Poses, t: int, rate_hz: float) -> np.ndarray:
    """The second differences at a frame that has one before and one after."""
    p, rotations = poses
    found = list((p[t + 1] - 2 * p[t] + p[t - 1]) * rate_hz**2 / 8.0)
    for axis in body.chain.axes:
        one = log(rotations[t - 1, axis.node].T @ rotations[t, axis.node])
        two = log(rotations[t, axis.node].T @ rotations[t + 1, axis.node])
        found.append((two - one)[axis.direction] * rate_hz**2 / 60.0)
    return np.array(found)


Terms = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


def jacobian(body: ChainBody, poses: Poses, rate_hz: float, triples: np.ndarray, own: Terms) -> tuple[
    np.ndarray, np.ndarray
]:  # fmt: skip
    """All residuals, and their derivatives by all parameters of all frames, by central differences.

    `own` are the residuals of one frame by its pose.
    """
    frames, size = len(poses.positions), body.chain.parameters

    def moved(t: int, step: np.ndarray) -> Poses:
        positions, rotations = poses.positions.copy(), poses.rotations.copy()
        positions[t], rotations[t] = stepped(body, positions[t], rotations[t], step)
        return Poses(positions, rotations)

    rows, residuals = [], []
    for t in range(frames):
        residuals.append(own(t, poses.positions[t], poses.rotations[t]))
        rows.append(np.zeros((len(residuals[-1]), frames * size)))
        for d in range(size):
            step = 1e-6 * np.eye(size)[d]
            one, two = (own(t, *stepped(body, poses.positions[t], poses.rotations[t], s)) for s in (step, -step))
            rows[-1][:, t * size + d] = (one - two) / 2e-6
        if not triples[t]:
            continue
        residuals.append(difference_residuals(body, poses, t, rate_hz))
        rows.append(np.zeros((len(residuals[-1]), frames * size)))
        for s in (t - 1, t, t + 1):
            for d in range(size):
                step = 1e-6 * np.eye(size)[d]
                one, two = (difference_residuals(body, moved(s, x), t, rate_hz) for x in (step, -step))
                rows[-1][:, s * size + d] = (one - two) / 2e-6
    return np.concatenate(residuals), np.concatenate(rows)
