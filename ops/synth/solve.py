"""This module does inverse kinematics from channels to Acclaim angles, with two-bone chains for legs and arms."""

from __future__ import annotations

import math

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematics import euler
from kinedex.ops.synth.body import BALL_HEIGHT, FOOT_SLOPE, NECK, PARENTS, SPINE, Body
from kinedex.ops.synth.score import INDEX

_SPINE_SHARES = (0.40, 0.32, 0.28)
_REACH = 0.995
_STRETCH = 0.99
_CLEARANCE = 0.018  # metres of height that every bone's end keeps above the floor


def about(axis: str, radians: F64 | float) -> F64:
    """Return the rotations (…, 3, 3) about x, y or z by angles in radians."""
    angle = np.asarray(radians, dtype=np.float64)
    i, j, k = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}[axis]
    result = np.zeros((*angle.shape, 3, 3))
    result[..., i, i] = 1.0
    result[..., j, j] = result[..., k, k] = np.cos(angle)
    result[..., k, j] = np.sin(angle)
    result[..., j, k] = -result[..., k, j]
    return result


def xyz_angles(rotations: F64) -> F64:
    """Return the angles (rx, ry, rz) in radians of rotations Rz·Ry·Rx, (T, 3), without jumps between frames."""
    y = np.arcsin(np.clip(-rotations[:, 2, 0], -1.0, 1.0))
    x = np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2])
    z = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
    return np.unwrap(np.stack([x, y, z], axis=1), axis=0)


def apply(rotations: F64, vectors: F64) -> F64:
    """Rotate vectors (3,) or (T, 3) by rotations (T, 3, 3) to vectors (T, 3)."""
    return (rotations * vectors[..., None, :]).sum(axis=-1)


def apply_inverse(rotations: F64, vectors: F64) -> F64:
    """Rotate vectors by the inverse rotations, (T, 3)."""
    return (rotations * vectors[..., :, None]).sum(axis=-2)


def unit(vectors: F64) -> F64:
    """Return vectors (T, 3) normalised to length 1; a zero vector stays zero."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors / np.maximum(length, 1e-12)


def columns(body: Body) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the columns of an angle table: the root's six values, then the degrees of freedom of movable bones."""
    root = ("root", ("tx", "ty", "tz", "rx", "ry", "rz"))
    return (root, *((bone.name, bone.dofs) for bone in body.bones if bone.dofs))


class _Pose:
    """The global rotations (T, 3, 3), far ends (T, 3) and angles of the bones that are solved so far."""

    def __init__(self, body: Body, channels: F64) -> None:
        self.body = body
        self.channels = channels
        self.rotation: dict[str, F64] = {}
        self.end: dict[str, F64] = {}
        self.angles: dict[str, F64] = {}

    def of(self, name: str) -> F64:
        return self.channels[:, INDEX[name]]

    def radians(self, name: str) -> F64:
        return np.radians(self.of(name))

    def point(self, *names: str) -> F64:
        return np.stack([self.of(name) for name in names], axis=1)

    def follow(self, name: str) -> None:
        """Add a bone without degrees of freedom, which takes its parent's rotation."""
        self._finish(name, self.rotation[PARENTS[name]])

    def turn(self, name: str, angles: F64) -> None:
        """Rotate a bone by the angles of its degrees of freedom, in radians, (T, number of them)."""
        bone = self.body.bone(name)
        axis = euler(bone.axis, "XYZ")
        local = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
        for column, dof in enumerate(bone.dofs):
            local = about(dof[1], angles[:, column]) @ local
        self.angles[name] = angles
        self._finish(name, self.rotation[PARENTS[name]] @ (axis @ local @ axis.T))

    def point_to(self, name: str, rotation: F64) -> None:
        """Set the global rotation of a bone with three degrees of freedom."""
        axis = euler(self.body.bone(name).axis, "XYZ")
        parent = self.rotation[PARENTS[name]]
        local = axis.T @ (np.swapaxes(parent, 1, 2) @ rotation) @ axis
        self.angles[name] = xyz_angles(local)
        self._finish(name, rotation)

    def _finish(self, name: str, rotation: F64) -> None:
        bone = self.body.bone(name)
        self.rotation[name] = rotation
        self.end[name] = self.end[PARENTS[name]] + apply(rotation, np.array(bone.direction) * bone.length)


def solve(body: Body, channels: F64) -> F64:
    """Convert channels to the angle table of an AMC file.

    Parameters
    ----------
    body : Body
        The actor's skeleton.
    channels : float64 array (T, channels)
        The channels, see `ops.synth.score.CHANNELS`.

    Returns
    -------
    float64 array (T, n)
        The angle table, with one column per root value and degree of freedom, in the order of `columns`. The root
        position is in metres, and angles are in degrees.
    """
    pose = _Pose(body, channels)
    root = pose.point("px", "py", "pz") * body.leg
    root[:, 1] += body.standing_root_height
    turned = about("y", pose.radians("yaw")) @ about("x", pose.radians("pitch")) @ about("z", pose.radians("roll"))
    root[:, 1] -= _sink(body, pose, root, turned)
    pose.rotation["root"], pose.end["root"] = turned, root
    for side in "lr":
        _leg(pose, side)
    _trunk(pose)
    for side in "lr":
        _arm(pose, side)
    lowest = np.min([end[:, 1] for end in pose.end.values()], axis=0)
    root[:, 1] += _calm(np.maximum(_CLEARANCE - lowest, 0.0))
    parts = [root, np.degrees(xyz_angles(turned))]
    parts += [np.degrees(pose.angles[name]) for name, _ in columns(body)[1:]]
    return np.concatenate(parts, axis=1)


def _hip_offset(body: Body, side: str) -> F64:
    bone = body.bone(side + "hipjoint")
    return np.array(bone.direction) * bone.length


def _foot_frame(pose: _Pose, side: str) -> F64:
    return about("y", pose.radians(side + "yaw")) @ about("x", pose.radians(side + "pitch"))


def _ankle(pose: _Pose, side: str) -> F64:
    """Return the target of the ankle: above the ball of a foot on the floor, or at the channels of a free foot."""
    place = pose.point(side + "x", side + "y", side + "z") * pose.body.leg
    slope = np.array([0.0, -math.sin(FOOT_SLOPE), math.cos(FOOT_SLOPE)]) * pose.body.bone(side + "foot").length
    free = pose.of(side + "free")[:, None]
    held = place - apply(_foot_frame(pose, side), slope)
    held[:, 1] += BALL_HEIGHT
    return held * (1 - free) + place * free


def _sink(body: Body, pose: _Pose, root: F64, turned: F64) -> F64:
    """Return the displacement (T,) in metres by which the pelvis must be lowered so that the legs reach the floor."""
    sink = np.zeros(len(root))
    for side in "lr":
        hip = root + apply(turned, _hip_offset(body, side))
        reach = hip - _ankle(pose, side)
        leg = body.length(side + "femur", side + "tibia") * _STRETCH
        level = reach[:, 0] ** 2 + reach[:, 2] ** 2
        allowed = np.sqrt(np.maximum(leg**2 - level, (0.25 * leg) ** 2))
        on_floor = np.clip(1.5 - pose.of(side + "y") / 0.04, 0.0, 1.0) * (1 - pose.of(side + "free"))
        sink = np.maximum(sink, (reach[:, 1] - allowed) * on_floor)
    return _calm(np.maximum(sink, 0.0))


def _calm(values: F64) -> F64:
    """Return a smooth curve that is nowhere below the given values."""
    width = 6
    padded = np.pad(values, width, mode="edge")
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1).max(axis=1)
    return _averaged(highest, width)


def _averaged(values: F64, width: int) -> F64:
    """Smooth a curve by a bell-shaped window of the given half-width in frames."""
    weights = np.hanning(2 * width + 3)[1:-1]
    padded = np.pad(values, width, mode="edge")
    return np.convolve(padded, weights / weights.sum(), mode="valid")


def _two_bones(pose: _Pose, upper: str, lower: float, goal: F64, bend_towards: F64) -> tuple[F64, F64, F64]:
    """Solve a chain of two bones: the upper bone's direction (T, 3), the hinge's axis (T, 3), and the flexion (T,).

    `lower` is the length of the second bone, and `goal` is the vector from the first joint to the end of the chain. The
    joint between the bones bends towards the direction `bend_towards`.
    """
    length = pose.body.bone(upper).length
    distance = np.sqrt((goal * goal).sum(axis=1))
    reach = _soft_limit(distance, (length + lower) * _REACH)
    reach = np.maximum(reach, abs(length - lower) + 0.25 * min(length, lower))
    line = goal / np.maximum(distance, 1e-9)[:, None]
    outwards = unit(bend_towards - line * (bend_towards * line).sum(axis=1, keepdims=True))
    cosine = np.clip((length**2 + reach**2 - lower**2) / (2 * length * reach), -1.0, 1.0)
    direction = line * cosine[:, None] + outwards * np.sqrt(1 - cosine**2)[:, None]
    inner = np.clip((length**2 + lower**2 - reach**2) / (2 * length * lower), -1.0, 1.0)
    return direction, np.cross(outwards, line), math.pi - np.arccos(inner)


def _soft_limit(values: F64, limit: float) -> F64:
    """Compress values smoothly below a limit; values far below it are almost unchanged."""
    knee = 0.04 * limit
    over = values - (limit - knee)
    return np.where(over > 0, limit - knee * np.exp(-np.maximum(over, 0) / knee), values)


def _frame(hinge: F64, direction: F64) -> F64:
    return np.stack([hinge, direction, np.cross(hinge, direction)], axis=-1)


def _aim(pose: _Pose, name: str, hinge: F64, direction: F64) -> None:
    """Rotate a bone so that it points along a direction and its x axis lies along the hinge."""
    bone = pose.body.bone(name)
    rest = _frame(euler(bone.axis, "XYZ")[:, 0], np.array(bone.direction))
    pose.point_to(name, _frame(hinge, direction) @ rest.T)


def _leg(pose: _Pose, side: str) -> None:
    body = pose.body
    pose.follow(side + "hipjoint")
    goal = _ankle(pose, side) - pose.end[side + "hipjoint"]
    outwards = 1.0 if side == "l" else -1.0
    across = pose.rotation["root"] @ about("y", outwards * pose.radians(side + "knee"))
    forwards = np.cross(across[:, :, 0], unit(goal)) * -1.0
    direction, hinge, flexion = _two_bones(pose, side + "femur", body.length(side + "tibia"), goal, forwards)
    _aim(pose, side + "femur", hinge, direction)
    pose.turn(side + "tibia", flexion[:, None])
    _foot(pose, side)


def _foot(pose: _Pose, side: str) -> None:
    """Orient the foot, fixed in the world or relative to the shin; the toes stay flat if the ball is on the ground."""
    bone = pose.body.bone(side + "foot")
    axis = euler(bone.axis, "XYZ")
    free = pose.of(side + "free")[:, None]
    slope = np.array([0.0, -math.sin(FOOT_SLOPE), math.cos(FOOT_SLOPE)])
    held = apply_inverse(pose.rotation[side + "tibia"] @ axis, apply(_foot_frame(pose, side), slope))
    rest = axis.T @ np.array(bone.direction)
    hanging = apply(about("x", np.clip(pose.radians(side + "pitch"), -0.5, 0.9) + 0.12), rest)
    wanted = unit(held * (1 - free) + hanging * free)
    # The foot rotates by rx about the ankle's hinge, then by rz about the shin; its rest direction has y < 0.
    height = np.clip(wanted[:, 2] / math.hypot(rest[1], rest[2]), -1.0, 1.0)
    pitch = math.pi - np.arcsin(height) - math.atan2(rest[2], rest[1])
    pitch = (pitch + math.pi) % (2 * math.pi) - math.pi
    swing = np.arctan2(wanted[:, 0], -wanted[:, 1])
    pose.turn(side + "foot", np.stack([np.clip(pitch, -1.45, 1.3), np.clip(swing, -1.0, 1.0)], axis=1))
    on_floor = np.clip(1.5 - pose.of(side + "y") / 0.06, 0.0, 1.0) * (1 - free[:, 0])
    flat = np.clip(pose.radians(side + "pitch"), -0.3, 1.1) * on_floor
    pose.turn(side + "toes", -flat[:, None])


def _trunk(pose: _Pose) -> None:
    turn = np.stack([pose.radians("bend"), pose.radians("twist"), pose.radians("side")], axis=1)
    for name, share in zip(SPINE, _SPINE_SHARES, strict=True):
        pose.turn(name, turn * share)
    turn = np.stack([pose.radians("nod"), pose.radians("look"), pose.radians("tilt")], axis=1)
    for name in NECK:
        pose.turn(name, turn / len(NECK))


def _arm(pose: _Pose, side: str) -> None:
    body = pose.body
    outwards = 1.0 if side == "l" else -1.0
    target = pose.point(side + "hx", side + "hy", side + "hz")
    # The shoulder follows an arm that is raised or reaches far.
    lift = np.clip(target[:, 1], 0.0, 1.0) * 0.20 + 0.01
    ahead = np.clip(target[:, 2], -0.5, 1.0) * 0.10
    pose.turn(side + "clavicle", np.stack([-outwards * ahead, outwards * lift], axis=1))
    chest = pose.rotation["thorax"]
    shoulder = pose.end[side + "clavicle"]
    target = target * np.array([outwards, 1.0, 1.0]) * body.length(side + "humerus", side + "radius", side + "wrist")
    goal = apply(chest, target)
    goal[:, 1] = np.maximum(goal[:, 1], 0.05 - shoulder[:, 1])
    inwards = apply_inverse(chest, goal)
    line = unit(inwards)
    raised = np.clip(line[:, 1], 0.0, 1.0)
    elbow = np.stack([outwards * (0.40 + 0.7 * raised), np.full(len(line), -0.75), -0.55 + 0.25 * raised], axis=1)
    elbow = unit(elbow - line * (elbow * line).sum(axis=1, keepdims=True))
    swivel = outwards * pose.radians(side + "swivel")[:, None]
    elbow = elbow * np.cos(swivel) + np.cross(line, elbow) * np.sin(swivel)
    # Where the hand passes the pole of the shoulder, the elbow must swing over smoothly, without a jump.
    elbow = np.stack([_averaged(elbow[:, i], 14) for i in range(3)], axis=1)
    forearm = body.length(side + "radius", side + "wrist")
    direction, hinge, flexion = _two_bones(pose, side + "humerus", forearm, goal, apply(chest, elbow))
    _aim(pose, side + "humerus", hinge, direction)
    pose.turn(side + "radius", flexion[:, None])
    _hand(pose, side)


def _hand(pose: _Pose, side: str) -> None:
    roll, wrist = pose.radians(side + "hroll"), pose.radians(side + "wrist")
    neutral = math.radians(-90.0)
    pose.turn(side + "wrist", (neutral + roll)[:, None])
    pose.turn(side + "hand", np.stack([wrist, 0.3 * roll], axis=1))
    pose.turn(side + "fingers", (0.2 + 0.3 * np.abs(wrist))[:, None])
    pose.turn(side + "thumb", np.stack([0.2 + 0.1 * wrist, 0.3 * roll], axis=1))
