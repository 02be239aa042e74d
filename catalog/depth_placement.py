"""The axes in which motion from depth is computed (the camera's, turned upright), and their place in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.arrays import F32, F64
from kinedex.ops.depth.floor import Floor, find_floor, upright_turn

FLIP = np.array([1.0, -1.0, -1.0])
"""The camera's axes (x right, y down, z forward) times this are x right, y up, z to the rear."""

NO_UP = (
    "neither pose nor `up` nor a floor is known: the camera is taken as level, without a floor; add `up:`, a vector "
    "that points upwards in the camera's axes, to its file, or a background that shows the floor"
)
"""The warning about a camera that is assumed to be level."""

FLOOR_OFF_M = 0.1
"""Largest distance in metres between the floor of the background and that of the camera's pose without a note."""


@dataclass(frozen=True, eq=False)
class Placement:
    """The inside axes of a recording: x right, Y up, z to the rear, with the camera at the origin, in metres.

    Attributes
    ----------
    turn : float64 array (3, 3)
        From (x, −y, −z) of the camera to the inside axes.
    floor_height : float or None
        The floor's Y: minus the height of the camera; None where it is not known.
    rotation : float64 array (3, 3)
        From the inside axes to the world, a turn about Y.
    place : float64 array (3,)
        The camera in the world.
    notes : tuple of str
        Sentences for the user on how these were found.
    """

    turn: F64
    floor_height: float | None
    rotation: F64
    place: F64
    notes: tuple[str, ...] = ()

    def inside(self, points: npt.ArrayLike) -> F64:
        """Return points (…, 3) of the camera's axes in the inside axes."""
        turned: F64 = (np.asarray(points, np.float64) * FLIP) @ self.turn.T
        return turned

    def in_camera(self, points: npt.ArrayLike) -> F64:
        """Transform points (…, 3) from the inside axes to the camera's axes."""
        seen: F64 = (np.asarray(points, np.float64) @ self.turn) * FLIP
        return seen

    def in_world(self, points: npt.ArrayLike) -> F64:
        """Transform points (…, 3) from the inside axes to the world; without a pose, Y = 0 is the floor if known."""
        placed: F64 = np.asarray(points, np.float64) @ self.rotation.T + self.place
        return placed

    def from_world(self, points: npt.ArrayLike) -> F64:
        """Transform points (…, 3) from the world to the inside axes."""
        inside: F64 = (np.asarray(points, np.float64) - self.place) @ self.rotation
        return inside


def placement_of(camera: DepthCamera, background: F32 | None, seed: int = 0) -> Placement:
    """Return the inside axes of a recording.

    A pose of the camera determines up and floor; a floor of the background that lies elsewhere gives a note. Without a
    pose, the largest level plane of the background is the floor, and its normal is up. Without such a plane, the
    camera's `up` is used; without that, a level camera without a floor is assumed, with a note.

    Parameters
    ----------
    camera : DepthCamera
        The camera.
    background : float32 array (H, W), optional
        Depths of the empty room in metres; 0 where they are not known.
    seed : int, optional
        Seed of the search for the floor.
    """
    upwards = camera.upwards
    if camera.rotation is not None and camera.place is not None and upwards is not None:
        turn = upright_turn(FLIP * upwards)
        height = -float(camera.place[1])
        notes = _contradiction(_floor_of(camera, background, seed), height)
        return Placement(turn, height, (camera.rotation.T * FLIP) @ turn.T, camera.place, notes)
    floor = _floor_of(camera, background, seed)
    if floor is not None:
        note = (
            f"the floor is {-floor.height:.2f} m below the camera, which is tilted by "
            f"{np.degrees(np.arccos(np.clip(floor.normal[1], -1, 1))):.1f}° ({floor.share:.0%} of the background)"
        )
        return Placement(
            upright_turn(floor.normal), floor.height, np.eye(3), np.array([0.0, -floor.height, 0.0]), (note,)
        )
    if upwards is not None:
        return Placement(upright_turn(FLIP * upwards), None, np.eye(3), np.zeros(3), ("no floor was found",))
    return Placement(np.eye(3), None, np.eye(3), np.zeros(3), (NO_UP,))


def _floor_of(camera: DepthCamera, background: F32 | None, seed: int) -> Floor | None:
    """Find the floor in a background image; None without a background, or if it shows no floor."""
    if background is None:
        return None
    upwards, seen = camera.upwards, background > 0
    points = np.concatenate([camera.rays[seen], np.ones((int(seen.sum()), 1))], axis=1) * background[seen, None]
    return find_floor(points * FLIP, None if upwards is None else FLIP * upwards, seed)


def _contradiction(floor: Floor | None, height: float) -> tuple[str, ...]:
    """Return a note where the floor of a background does not lie at the height that the camera's pose gives it."""
    if floor is None or abs(floor.height - height) <= FLOOR_OFF_M:
        return ()
    return (
        f"in the background the floor lies {-floor.height:.2f} m below the camera, and by its `pose` {-height:.2f} m: "
        "are fx, fy, `depth_unit_m` and `pose` those of this recording?",
    )
