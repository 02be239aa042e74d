"""The kinematic chain as its definition has it: products of matrices, plain residuals, central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kinedex.ops.body.kinematic_chain import ChainBody


def cross(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def exp(vector: np.ndarray) -> np.ndarray:
    angle = np.sqrt((vector**2).sum())
    axis = cross(vector / angle) if angle else np.zeros((3, 3))
    return np.eye(3) + np.sin(angle) * axis + (1 - np.cos(angle)) * axis @ axis


def log(rotation: np.ndarray) -> np.ndarray:
    """The rotation vector, of less than half a turn."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    skew = (rotation - rotation.T) / 2
    scale = angle / np.sin(angle) if angle > 1e-9 else 1.0
    return scale * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def joints(body: ChainBody, place: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """The joints (J, 3) of one pose."""
    chain = body.chain
    world, centres = [], []
    for k, parent in enumerate(chain.parents):
        world.append(rotations[k] if parent < 0 else world[parent] @ rotations[k])
        offset = body.offsets[chain.centres[k]]
        centres.append(place if parent < 0 else centres[parent] + world[parent] @ offset)
    return np.array([
        centres[rest.node] + world[rest.node] @ offset
        for rest, offset in zip(chain.rest, body.offsets, strict=True)
    ])  # fmt: skip


def stepped(
    body: ChainBody, place: np.ndarray, rotations: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The pose after a step of its parameters."""
    vectors = np.zeros((len(rotations), 3))
    for axis, x in zip(body.chain.axes, step[3:], strict=True):
        vectors[axis.node, axis.direction] += axis.sign * x
    return place + step[:3], np.array([turn @ exp(vector) for turn, vector in zip(rotations, vectors, strict=True)])


def residuals(
    body: ChainBody, place: np.ndarray, rotations: np.ndarray, points: np.ndarray, sigma: float = 0.01
) -> np.ndarray:
    """All terms of a fit as one vector."""
    found = [(joints(body, place, rotations) - points)[np.isfinite(points)] / sigma]
    logs = [log(turn) for turn in rotations]
    for axis in body.chain.axes:
        turn = axis.sign * logs[axis.node][axis.direction]
        found.append(np.array([turn / axis.pull, (turn - np.clip(turn, *axis.hinge)) / 0.05]))
    return np.concatenate(found)


def derivatives(terms: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """The derivatives of residuals at 0, by central differences."""
    steps = 1e-6 * np.eye(size)
    return np.stack([(terms(step) - terms(-step)) / 2e-6 for step in steps], axis=1)
