"""This module simulates a room with a floor, a wall and a person in front of a level depth camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, U16, Bool
from kinedex.ops.body.facing_direction import turn_about_y
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.simulation.depth_rays import ConeRays, Flesh, cone_ends, draw_surface, facing
from kinedex.ops.simulation.depth_sensors import BASELINE_M, DepthSensor, ExtraErrors, measured

TOES_M = 0.03
"""Height in metres above the floor at which `on_floor` puts the 5th percentile of the height of the lower toes."""

EYE_M, DISTANCE_M, STEP_M, MAX_STEPS = 1.1, 3.0, 0.25, 20
MIN_DEPTH_M, WALL_M = 0.8, 1.5
BORDER_PX = (6.0, 6.0, 8.0, 4.0)
"""Minimum distance in pixels of the joints from the image's left, right, upper and lower border."""

EMPTY_FRAMES = 15
"""Number of frames of the empty room whose median is the background."""


def on_floor(joints: F64) -> F64:
    """Shift a take (T, 24, 3) vertically so that its feet stand on the floor at Y = 0."""
    toes = joints[:, [JOINTS.index("ltoes"), JOINTS.index("rtoes")], 1].min(axis=1)
    return joints - np.array([0.0, np.percentile(toes, 5) - TOES_M, 0.0])


@dataclass(frozen=True, eq=False)
class CameraPlace:
    """The position and orientation of a level camera.

    Attributes
    ----------
    rotation : float64 array (3, 3)
        The rotation from the world to the camera: x_camera = rotation · (x_world − place).
    place : float64 array (3,)
        The position of the camera in metres, Y up.
    outside : bool array (T,)
        The frames with a joint outside the image or its border, or nearer than 0.8 m.
    """

    rotation: F64
    place: F64
    outside: Bool

    def seen(self, points: F64) -> F64:
        """Transform points (…, 3) from world axes to the axes of the camera."""
        found: F64 = (points - self.place) @ self.rotation.T
        return found


def place_camera(sensor: DepthSensor, joints: F64, azimuth: float = 0.0) -> CameraPlace:
    """Place a level camera in front of a take, looking against the person's mean facing direction.

    The camera is moved back, by at most 5 m, until every joint is inside the image.

    Parameters
    ----------
    sensor : DepthSensor
        The camera.
    joints : float64 array (T, 24, 3)
        The take in metres, Y up, with the floor at Y = 0.
    azimuth : float, optional
        The angle in radians about Y from the mean facing direction to the camera, towards the person's left.
    """
    if not len(joints) or not np.isfinite(joints).all():
        raise ParameterError("joints", "finite in all frames, of which there is one or more", joints.shape)
    root = joints[:, JOINTS.index("root")]
    middle = (root.min(axis=0) + root.max(axis=0)) / 2.0
    ahead = facing(joints).mean(axis=0)
    length = np.linalg.norm(ahead)
    ahead = ahead / length if length > 0 else np.array([0.0, 0.0, 1.0])
    ahead = turn_about_y(ahead, azimuth)
    rotation = np.array([np.cross(-ahead, [0.0, 1.0, 0.0]), [0.0, -1.0, 0.0], -ahead])
    for step in range(MAX_STEPS + 1):
        place = middle + (DISTANCE_M + STEP_M * step) * ahead
        place[1] = EYE_M
        outside = _outside(sensor, (joints - place) @ rotation.T)
        if not outside.any():
            break
    return CameraPlace(rotation, place, outside)


def _outside(sensor: DepthSensor, seen: F64) -> Bool:
    """Return a mask (T,) of the frames with a joint that is too near, or outside the image or its border."""
    (width, height), (cx, cy) = sensor.size, sensor.centre
    left, right, upper, lower = BORDER_PX
    near = seen[..., 2] < MIN_DEPTH_M
    depth = np.where(near, MIN_DEPTH_M, seen[..., 2])
    u = sensor.focal_px * seen[..., 0] / depth + cx
    v = sensor.focal_px * seen[..., 1] / depth + cy
    out = near | (u < left) | (u > width - 1 - right) | (v < upper) | (v > height - 1 - lower)
    return np.asarray(out.any(axis=1))


class DepthScene:
    """A take in a room, recorded by a depth camera; the same arguments and calls give identical bytes.

    Parameters
    ----------
    sensor : DepthSensor
        The camera.
    flesh : Flesh
        The cones of the body.
    disturbance : ExtraErrors
        Errors in addition to those of the sensor.
    joints : float64 array (T, 24, 3)
        The take in metres, Y up; `on_floor` puts it on the floor at Y = 0.
    height_m : float
        Standing height of the person in metres.
    camera : CameraPlace
        The position and orientation of the camera, see `place_camera`.
    generator : numpy.random.Generator
        The generator from which the surface of the body and all errors are drawn.
    """

    def __init__(
        self, sensor: DepthSensor, flesh: Flesh, disturbance: ExtraErrors, joints: F64, height_m: float,
        camera: CameraPlace, generator: np.random.Generator,
    ) -> None:  # fmt: skip
        self.sensor, self._disturbance, self._generator = sensor, disturbance, generator
        surface = draw_surface(flesh, height_m, generator)
        self._rays = ConeRays(surface, sensor.focal_px, sensor.centre, sensor.size)
        self._ends = np.ascontiguousarray(camera.seen(cone_ends(flesh, joints)))
        wall = float(camera.seen(joints)[..., 2].max()) + WALL_M
        self._room = _room(sensor, float(camera.place[1]), wall)

    def __len__(self) -> int:
        return len(self._ends)

    def true_depth(self, frame: int) -> tuple[F64, Bool]:
        """Return the true depth (H, W) of a frame in metres, and a mask (H, W) of the body's pixels."""
        body = self._rays.depth(self._ends[frame])
        return np.minimum(body, self._room), body < self._room

    def background(self) -> U16:
        """Return the depth (H, W) of the empty room in millimetres, as the median of several frames."""
        nothing = np.zeros(self._room.shape, np.bool_)
        frames = [
            measured(self.sensor, self._room, nothing, nothing, self._disturbance, self._generator)
            for _ in range(EMPTY_FRAMES)
        ]
        return np.median(frames, axis=0).astype(np.uint16)

    def frame(self, frame: int) -> U16:
        """Return the measured depth (H, W) of a frame in millimetres."""
        depth, body = self.true_depth(frame)
        shadow = np.zeros(body.shape, np.bool_)
        if self.sensor.kind == "structured":
            shadow = self._rays.shadow(self._ends[frame], depth, BASELINE_M)
        return measured(self.sensor, depth, body, shadow, self._disturbance, self._generator)


def _room(sensor: DepthSensor, eye_m: float, wall_m: float) -> F64:
    """Return the depth (H, W) in metres of a floor and a wall."""
    down = (np.arange(sensor.size[1]) - sensor.centre[1]) / sensor.focal_px
    floor = np.divide(eye_m, down, out=np.full_like(down, np.inf), where=down > 0)
    return np.repeat(np.minimum(floor, wall_m)[:, None], sensor.size[0], axis=1)
