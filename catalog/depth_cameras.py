"""Define depth cameras: the camera model of `catalog.cameras`, the unit of depth images, and the upward direction.

In the camera, x points right, y down and z forward; pixel centres are whole numbers. A camera with a pose satisfies
x_camera = rotation · (x_world − place), in a world in metres with Y up and the floor at Y = 0. For a camera without a
pose, `up` may be the direction that points upwards in the camera's axes, as measured by an accelerometer at rest.
Motion from depth is computed in the inside axes, which are the camera's axes after a rotation that makes them upright;
a `Placement` holds the transformation between the inside axes and the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinedex.catalog.cameras import Camera
from kinedex.ops.arrays import F32, F64, Array
from kinedex.ops.cameras import projection
from kinedex.ops.depth.floor import Floor, find_floor, upright_rotation
from kinedex.ops.errors import ParameterError

NOT_MEASURED = (0, 65535)
"""Values of integer images that mark pixels without a measurement."""

MAX_PIXELS = 1 << 22
"""Maximum number of pixels of an image; larger images are rejected, since no depth camera records them."""

FARTHEST_M = 1e6
"""Depths beyond this, in metres, count as not measured."""

FASTEST_HZ = 10_000.0
"""Maximum number of frames per second of a camera; higher rates are rejected."""

_LARGEST_UNIT_M = 1.0

FLIP = np.array([1.0, -1.0, -1.0])
"""Factors that convert coordinates with x right, y down, z forward to x right, y up, z backward."""

NO_UP = (
    "neither pose nor `up` nor a floor is known: the camera is taken as level, without a floor; add `up:`, a vector "
    "that points upwards in the camera's axes, to its file, or a background that shows the floor"
)
"""The warning about a camera that is assumed to be level."""

FLOOR_OFF_M = 0.1
"""Distance in metres between the background's floor and that of the camera's pose above which a note is given."""


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """A calibrated depth camera.

    Attributes
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    size : tuple of (int, int)
        Width and height of its images in pixels.
    depth_unit_m : float
        The number of metres of one unit of integer images.
    rate_hz : float, optional
        Frames per second.
    is_range : bool
        True if images hold distances along the ray instead of depths z.
    rotation : float64 array (3, 3), optional
        The rotation from the world to the camera.
    place : float64 array (3,), optional
        The camera's centre in the world in metres; given if and only if `rotation` is.
    up : float64 array (3,), optional
        The direction that points upwards, in the camera's axes; a vector of any length is normalised. It must not be
        given with a pose, which implies it.

    Raises
    ------
    ParameterError
        A value is out of its domain; the message names the attribute.
    """

    matrix: F64
    distortion: F64
    size: tuple[int, int]
    depth_unit_m: float = 0.001
    rate_hz: float | None = None
    is_range: bool = False
    rotation: F64 | None = None
    place: F64 | None = None
    up: F64 | None = None

    def __post_init__(self) -> None:
        if (self.rotation is None) != (self.place is None):
            raise ParameterError("place", "given with `rotation`, or neither", "one of them")
        if not 0 < self.depth_unit_m <= _LARGEST_UNIT_M:
            raise ParameterError("depth_unit_m", f"above 0 and at most {_LARGEST_UNIT_M:g}", self.depth_unit_m)
        if self.rate_hz is not None and not 0 < self.rate_hz <= FASTEST_HZ:
            raise ParameterError("rate_hz", f"above 0 and at most {FASTEST_HZ:g}", self.rate_hz)
        if self.up is not None:
            if self.rotation is not None:
                raise ParameterError("up", "absent beside a pose, which implies it", np.asarray(self.up).tolist())
            object.__setattr__(self, "up", _unit_vector("up", self.up))
        camera = self.camera
        if self.size[0] * self.size[1] > MAX_PIXELS:
            raise ParameterError("size", f"of at most {MAX_PIXELS:,} pixels", self.size)
        for key in ("matrix", "distortion"):
            object.__setattr__(self, key, getattr(camera, key))
        if self.rotation is not None:
            object.__setattr__(self, "rotation", camera.rotation)
            object.__setattr__(self, "place", np.ascontiguousarray(self.place, np.float64))

    @cached_property
    def camera(self) -> Camera:
        """The camera in the world if it has a pose, otherwise at the origin of its own axes."""
        rotation, place = np.eye(3), np.zeros(3)
        if self.rotation is not None and self.place is not None:
            rotation, place = np.asarray(self.rotation, np.float64), np.asarray(self.place, np.float64)
            for key, values, shape in (("rotation", rotation, (3, 3)), ("place", place, (3,))):
                if values.shape != shape:
                    raise ParameterError(key, f"of shape {shape}", values.shape)
        return Camera("depth", self.matrix, self.distortion, rotation, -rotation @ place, self.size)

    @property
    def upwards(self) -> F64 | None:
        """The unit vector that points upwards in the camera's axes, from the pose or from `up`; None if unknown."""
        return self.up if self.rotation is None else self.rotation[:, 1].copy()

    @cached_property
    def rays(self) -> F64:
        """The rays of its pixels without distortion, as a and b (H, W, 2) of (a, b, 1); NaN where there is no ray."""
        width, height = self.size
        (fx, skew, cx), (_, fy, cy) = self.matrix[:2]
        b = np.broadcast_to((np.arange(height)[:, None] - cy) / fy, (height, width))
        a = (np.arange(width) - cx - skew * b) / fx
        return projection.undistort(self.distortion, np.stack([a, b], axis=-1))

    @cached_property
    def _depth_shares(self) -> F64 | None:
        """Return the factors (H, W) from measured values to depths z; None if the values are depths already."""
        known = np.isfinite(self.rays[..., 0]) if self.distortion.any() else None
        if not self.is_range:
            return None if known is None or known.all() else known.astype(np.float64)
        lengths: F64 = np.sqrt(1 + np.einsum("...i,...i->...", self.rays, self.rays))
        return np.where(np.isfinite(lengths), 1 / lengths, 0.0)

    @cached_property
    def _depth_table(self) -> F32:
        """Return the depth in metres of each 16-bit value, float32 (65536,)."""
        table = (np.arange(1 << 16) * self.depth_unit_m).astype(np.float32)
        table[list(NOT_MEASURED)] = 0.0
        return table

    def depths(self, values: Array) -> F32:
        """Convert the stored values of an image to depths z in metres.

        Parameters
        ----------
        values : integer or floating array (H, W)
            Integers in units of `depth_unit_m`, or floats in metres; distances along the ray if `is_range`.

        Returns
        -------
        float32 array (H, W)
            Depths; 0 where nothing was measured (the value is 0, 65535, NaN, below 0 or beyond `FARTHEST_M`), or where
            the lens model has no ray.

        Raises
        ------
        ParameterError
            The image has another size, or values of another kind.
        """
        width, height = self.size
        if values.shape != (height, width) or values.dtype.kind not in "iuf":
            raise ParameterError(
                "values", f"numbers of shape {(height, width)}", f"{values.dtype} of shape {values.shape}"
            )
        if values.dtype == np.uint16 and self._depth_shares is None:
            depths: F32 = self._depth_table[values]
            return depths
        with np.errstate(invalid="ignore"):  # the conversion of NaN values may raise a floating-point flag
            found = values.astype(np.float64)
        if values.dtype.kind == "f":
            measured = (found > 0) & (found < np.inf)
        else:
            measured = (values > NOT_MEASURED[0]) & (values != NOT_MEASURED[1])
            found *= self.depth_unit_m
        if self._depth_shares is not None:
            found *= np.where(measured, self._depth_shares, 0.0)
        found = np.where(measured, found, 0.0)
        return np.where(found <= FARTHEST_M, found, 0.0).astype(np.float32)

    def project(self, points: npt.ArrayLike) -> tuple[F64, F64]:
        """Return pixels (…, 2) and depths (…,) in metres of points (…, 3) in the camera's axes."""
        return projection.project(self.matrix, np.eye(3), np.zeros(3), self.distortion, points)


def _unit_vector(name: str, values: npt.ArrayLike) -> F64:
    vector = np.ascontiguousarray(values, np.float64)
    if vector.shape != (3,):
        raise ParameterError(name, "of shape (3,)", vector.shape)
    length = float(np.linalg.norm(vector)) if (np.abs(vector) <= 1e9).all() else np.nan
    if not length > 1e-9:
        raise ParameterError(name, "a finite direction, not 0", vector.tolist())
    return vector / length


@dataclass(frozen=True, eq=False)
class Placement:
    """The inside axes of a recording: x right, y up and z backward in metres, with the camera at the origin.

    Attributes
    ----------
    turn : float64 array (3, 3)
        The rotation from (x, −y, −z) of the camera to the inside axes.
    floor_height : float or None
        The Y coordinate of the floor, which is minus the height of the camera; None if it is not known.
    rotation : float64 array (3, 3)
        The rotation about Y from the inside axes to the world.
    place : float64 array (3,)
        The position of the camera in the world.
    notes : tuple of str
        Sentences for the user on assumptions and contradictions in these values.
    """

    turn: F64
    floor_height: float | None
    rotation: F64
    place: F64
    notes: tuple[str, ...] = ()

    def inside(self, points: npt.ArrayLike) -> F64:
        """Transform points (…, 3) from the camera's axes to the inside axes."""
        turned: F64 = (np.asarray(points, np.float64) * FLIP) @ self.turn.T
        return turned

    def in_world(self, points: npt.ArrayLike) -> F64:
        """Transform points (…, 3) from the inside axes to the world; without a pose, Y = 0 is the floor if known."""
        placed: F64 = np.asarray(points, np.float64) @ self.rotation.T + self.place
        return placed


def placement_of(camera: DepthCamera, background: F32 | None, seed: int = 0) -> Placement:
    """Determine the upward direction and the floor of a recording, and from them its inside axes.

    If the camera has a pose, the pose determines both; a background whose floor lies elsewhere gives a note. Otherwise
    the largest level plane of the background is the floor, and its normal is up. If there is no such plane, the
    camera's `up` is used; if the camera has none, it is assumed to be level, without a floor, and a note says so.

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
        turn = upright_rotation(FLIP * upwards)
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
            upright_rotation(floor.normal), floor.height, np.eye(3), np.array([0.0, -floor.height, 0.0]), (note,)
        )
    if upwards is not None:
        return Placement(upright_rotation(FLIP * upwards), None, np.eye(3), np.zeros(3), ("no floor was found",))
    return Placement(np.eye(3), None, np.eye(3), np.zeros(3), (NO_UP,))


def _floor_of(camera: DepthCamera, background: F32 | None, seed: int) -> Floor | None:
    """Return the floor in a background image; None if there is no background or it shows no floor."""
    if background is None:
        return None
    upwards, seen = camera.upwards, background > 0
    points = np.concatenate([camera.rays[seen], np.ones((int(seen.sum()), 1))], axis=1) * background[seen, None]
    return find_floor(points * FLIP, None if upwards is None else FLIP * upwards, seed)


def _contradiction(floor: Floor | None, height: float) -> tuple[str, ...]:
    """Return a note if the background's floor is not at the height that follows from the camera's pose."""
    if floor is None or abs(floor.height - height) <= FLOOR_OFF_M:
        return ()
    return (
        f"in the background the floor lies {-floor.height:.2f} m below the camera, and by its `pose` {-height:.2f} m: "
        "are fx, fy, `depth_unit_m` and `pose` those of this recording?",
    )
