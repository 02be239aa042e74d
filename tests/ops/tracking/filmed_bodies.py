"""Bodies that move smoothly, and the rays of their keypoints in a ring of cameras."""

from __future__ import annotations

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.tracking.observations import BodyPoints, Rays
from tests.oracles import kinematic_chain as oracle
from tests.oracles.tracking import body_points

CHAIN = load_kinematic_chain()
LENGTHS = {
    "belly": 0.12, "chest": 0.12, "neck": 0.14, "head": 0.1, "headtop": 0.16, "shoulder": 0.18, "elbow": 0.28,
    "wrist": 0.25, "fingers": 0.12, "knee": 0.42, "ankle": 0.42, "toes": 0.15,
}  # fmt: skip
LIMBS = [CHAIN.joint(side + name) for side in "lr" for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]


def example_body() -> ChainBody:
    """The body of the worked example."""
    offsets = np.zeros((24, 3))
    for j, (name, rest) in enumerate(zip(CHAIN.joints, CHAIN.rest, strict=True)):
        if rest.along is not None:
            offsets[j] = np.array(rest.along) * LENGTHS[name if name in LENGTHS else name[1:]]
    offsets[CHAIN.joint("lhip")], offsets[CHAIN.joint("rhip")] = (0.1, -0.08, 0), (-0.1, -0.08, 0)
    for name in ("lclavicle", "rclavicle"):
        offsets[CHAIN.joint(name)] = offsets[CHAIN.joint("neck")]
    return ChainBody(CHAIN, offsets)


BODY = example_body()


def keypoints(names: tuple[str, ...] = (), nose: bool = True) -> BodyPoints:
    """The limb joints and toes, or the joints named, and a nose."""
    joints = [CHAIN.joint(name) for name in names] or [*LIMBS, CHAIN.joint("ltoes"), CHAIN.joint("rtoes")]
    nodes, offsets = [CHAIN.rest[j].node for j in joints], [BODY.offsets[j] for j in joints]
    if nose:
        joints, nodes = [*joints, -1], [*nodes, CHAIN.nodes.index("neck")]
        offsets.append(np.array([0, 0.06, 0.12]))
    return BodyPoints(np.array(nodes), np.array(offsets), np.array(joints))


def moving_poses(frames: int, seed: int = 1, size: float = 0.35) -> Poses:
    """Poses that swing slowly and smoothly, with hinges that bend their way, at 30 Hz."""
    random = np.random.default_rng(seed)
    moments = np.arange(frames) / 30.0
    rotations = np.tile(np.eye(3), (frames, len(CHAIN.nodes), 1, 1))
    vectors = np.zeros((frames, len(CHAIN.nodes), 3))
    for axis in CHAIN.axes:
        phase, rate, most = random.uniform(0, 6.28), random.uniform(0.1, 0.5), random.uniform(0.3, 1) * size
        if axis.node == 0:
            most = 0.2
        swing = most * np.sin(6.28 * rate * moments + phase)
        if np.isfinite(axis.hinge[1]):
            swing = 0.5 + swing
        vectors[:, axis.node, axis.direction] = axis.sign * swing
    for t in range(frames):
        rotations[t] = [oracle.exp(vector) for vector in vectors[t]]
    positions = np.stack([0.4 * np.sin(moments), 0.95 + 0.03 * np.cos(3 * moments), 0.3 * moments], axis=1)
    return Poses(positions, rotations)


def filmed(poses: Poses, points: BodyPoints, noise: float = 0.0, seed: int = 0, cameras: int = 4) -> Rays:
    """The rays of a body's points in cameras around it, whose directions have noise in radians."""
    random = np.random.default_rng(seed)
    angles = 0.3 + 2 * np.pi * np.arange(cameras) / cameras
    centres = np.stack([4 * np.sin(angles), np.full(cameras, 2.2), 4 * np.cos(angles)], axis=1)
    positions = np.stack([
        body_points(BODY, points, place, rotations) for place, rotations in zip(poses.positions, poses.rotations,
        strict=True)
    ])  # fmt: skip
    ways = positions[:, None] - centres[None, :, None]
    ways /= np.sqrt((ways**2).sum(axis=3, keepdims=True))
    ways += random.normal(0, noise, ways.shape)
    ways /= np.sqrt((ways**2).sum(axis=3, keepdims=True))
    return Rays(centres, np.full(cameras, 1000.0), ways, random.uniform(0.6, 1.0, ways.shape[:3]))


def joint_places(poses: Poses) -> np.ndarray:
    """The joints (T, J, 3)."""
    return np.moveaxis(forward(BODY, poses)[0], 2, 0)
