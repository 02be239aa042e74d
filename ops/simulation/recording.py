"""This module simulates a recording of a take by cameras with a keypoint detector.

The detector has systematic offsets, noise, confidences and outliers, and fails from time to time.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.body.pose_fit import fit_poses
from kinedex.ops.cameras.projection import project
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import BodyPoints

KINDS = ("views", "occluded", "swapped", "stuck")
"""The kinds of failures.

- views: half of the cameras report nothing.
- occluded: a limb is reported at a wrong position, with low confidence, in half of the cameras or more, but not in all.
- swapped: left and right leg are exchanged from hip to toe, with full confidence, in half of the cameras or fewer.
- stuck: elbow and wrist are reported at those of the other arm, in half of the cameras or more, but not in all.
"""

LIMB_PX, KEYPOINT_PX, WOBBLE_PX, STUCK_PX = 70.0, 20.0, 8.0, 6.0
"""Standard deviations of position errors per axis in pixels. The error of an occluded keypoint is the sum of an error
of the limb in a camera, of an error of the keypoint, and of an error in each frame; the last number is the error of
stuck keypoints in each frame."""

OCCLUDED_CONFIDENCE, STUCK_CONFIDENCE = (0.25, 0.6), 0.6


@dataclass(frozen=True)
class FailureRate:
    """The frequency and duration of failures.

    Attributes
    ----------
    per_second : float
        The number of failures per second.
    shortest_s, longest_s : float
        The smallest and largest duration in seconds.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    per_second: float = 0.67
    shortest_s: float = 0.4
    longest_s: float = 1.2

    def __post_init__(self) -> None:
        if not 0 <= self.per_second <= 100:
            raise ParameterError("per_second", "from 0 to 100 failures a second", self.per_second)
        if not 0 < self.shortest_s <= self.longest_s < np.inf:
            raise ParameterError("shortest_s", "above 0 and not above longest_s", (self.shortest_s, self.longest_s))


LONG = FailureRate(shortest_s=1.2, longest_s=2.2)
"""The rate of long failures."""


@dataclass(frozen=True, eq=False)
class Limbs:
    """The keypoints of limbs, in the same order on both sides.

    Attributes
    ----------
    arms : tuple of int64 array
        Elbow and wrist, left and right.
    legs : tuple of int64 array
        Hip to toes, left and right; the hip comes first.
    """

    arms: tuple[I64, I64]
    legs: tuple[I64, I64]

    def named(self, limb: str) -> I64:
        """Return the keypoints of a limb that a failure displaces: the whole arm, or the leg without the hip."""
        side = "lr".index(limb[0])
        return self.arms[side] if limb[1:] == "arm" else self.legs[side][1:]


LIMBS = ("larm", "rarm", "lleg", "rleg")


@dataclass(frozen=True)
class Failure:
    """A failure of the detector in the frames [start, stop).

    Attributes
    ----------
    start, stop : int
        The frames.
    kind : str
        One of `KINDS`.
    limb : str
        One of `LIMBS`, "legs" for both, "body" for all keypoints.
    cameras : tuple of int
        The cameras in which it occurs.
    """

    start: int
    stop: int
    kind: str
    limb: str
    cameras: tuple[int, ...]


def draw_failures(
    rate: FailureRate, frames: int, rate_hz: float, cameras: int, generator: np.random.Generator
) -> list[Failure]:
    """Draw the failures of a take; they may overlap.

    Parameters
    ----------
    rate : FailureRate
        The frequency and duration of failures.
    frames : int
        The number of frames of the take.
    rate_hz : float
        Frames per second.
    cameras : int
        The number of cameras V.
    generator : numpy.random.Generator
        The generator from which kind, limb, length, start and cameras are drawn, each uniformly.

    Returns
    -------
    list of Failure
        The failures, sorted by start. With a single camera, only "views" occurs.
    """
    half = max(1, cameras // 2)
    counts = {
        "views": (half, half),
        "occluded": (half, cameras - 1),
        "swapped": (1, half),
        "stuck": (half, cameras - 1),
    }
    found = []
    for _ in range(round(rate.per_second * frames / rate_hz)):
        kind = KINDS[int(generator.integers(len(KINDS)))] if cameras > 1 else "views"
        limb = LIMBS[int(generator.integers(2 if kind == "stuck" else len(LIMBS)))]
        length = min(frames, max(1, round(generator.uniform(rate.shortest_s, rate.longest_s) * rate_hz)))
        start = int(generator.integers(frames - length + 1))
        low, high = counts[kind]
        number = int(generator.integers(low, high + 1))
        chosen = tuple(sorted(generator.permutation(cameras)[:number].tolist()))
        limb = {"views": "body", "swapped": "legs"}.get(kind, limb)
        found.append(Failure(start, start + length, kind, limb, chosen))
    return sorted(found, key=lambda one: (one.start, one.stop, one.kind, one.limb, one.cameras))


def with_failures(
    failures: Sequence[Failure], limbs: Limbs, pixels: F64, confidence: F64, generator: np.random.Generator
) -> tuple[F64, F64]:
    """Apply failures to keypoints, one after the other.

    Parameters
    ----------
    failures : sequence of Failure
        The failures.
    limbs : Limbs
        The keypoints of limbs.
    pixels : float64 array (T, V, P, 2)
        Positions in the images.
    confidence : float64 array (T, V, P)
        The confidence of each keypoint.
    generator : numpy.random.Generator
        The generator from which the wrong positions of limbs are drawn.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The positions with failures.
    confidence : float64 array (T, V, P)
        The confidence of each keypoint with failures.
    """
    moved, trusted = pixels.copy(), confidence.copy()
    for one in failures:
        for camera in one.cameras:
            _fail(one, limbs, moved[one.start : one.stop, camera], trusted[one.start : one.stop, camera], generator)
    return moved, trusted


def _fail(one: Failure, limbs: Limbs, pixels: F64, confidence: F64, generator: np.random.Generator) -> None:
    """Apply a failure to the keypoints (T, P, 2) and the confidence (T, P) of a camera, in place."""
    if one.kind == "views":
        confidence[:] = 0.0
    elif one.kind == "swapped":
        left, right = limbs.legs
        for values in (pixels, confidence):
            values[:, np.concatenate([left, right])] = values[:, np.concatenate([right, left])]
    elif one.kind == "occluded":
        mine = limbs.named(one.limb)
        off = generator.normal(0.0, LIMB_PX, 2) + generator.normal(0.0, KEYPOINT_PX, (len(mine), 2))
        pixels[:, mine] += off + generator.normal(0.0, WOBBLE_PX, (len(pixels), len(mine), 2))
        confidence[:, mine] = generator.uniform(*OCCLUDED_CONFIDENCE, (len(pixels), len(mine)))
    else:
        mine = limbs.named(one.limb)
        other = limbs.named("rarm" if one.limb == "larm" else "larm")
        pixels[:, mine] = pixels[:, other] + generator.normal(0.0, STUCK_PX, (len(pixels), len(mine), 2))
        confidence[:, mine] = STUCK_CONFIDENCE


@dataclass(frozen=True)
class Detector:
    """The error model of a keypoint detector.

    Attributes
    ----------
    offset_m : float
        Standard deviation per axis of a keypoint's offset from its true position, in metres. The offset is constant in
        the frame of the body segment during a take.
    noise_px : float
        Standard deviation per axis of the noise, in pixels.
    correlation : float
        Correlation of the noise of consecutive frames, an AR(1) process.
    confidence, confidence_sd : float
        Mean and standard deviation of the confidence, which is clipped to [0.5, 1].
    outliers : float
        Fraction of keypoints that are outliers.
    outlier_px : float
        Standard deviation per axis of the error of outliers, in pixels; their confidence is uniform in [0.3, 0.9].

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    offset_m: float = 0.012
    noise_px: float = 4.0
    correlation: float = 0.7
    confidence: float = 0.85
    confidence_sd: float = 0.07
    outliers: float = 0.02
    outlier_px: float = 80.0

    def __post_init__(self) -> None:
        for name in ("offset_m", "noise_px", "confidence_sd", "outlier_px"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(name, "at least 0", getattr(self, name))
        for name, below in (("confidence", 1.0), ("outliers", 1.0), ("correlation", 0.999)):
            if not 0 <= getattr(self, name) <= below:
                raise ParameterError(name, f"from 0 to {below:g}", getattr(self, name))


MIN_CONFIDENCE, OUTLIER_CONFIDENCE = 0.5, (0.3, 0.9)


def segment_offsets(detector: Detector, points: int, generator: np.random.Generator) -> F64:
    """Draw the offset (P, 3) of each keypoint in the frame of its node, in metres."""
    return generator.normal(0.0, detector.offset_m, (points, 3))


def detected_keypoints(detector: Detector, pixels: F64, generator: np.random.Generator) -> tuple[F64, F64]:
    """Draw the keypoints that a detector reports.

    Parameters
    ----------
    detector : Detector
        The errors.
    pixels : float64 array (T, V, P, 2)
        The true positions in the images; NaN for points behind a camera.
    generator : numpy.random.Generator
        The generator from which noise, outliers and confidences are drawn.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The reported positions.
    confidence : float64 array (T, V, P)
        The confidence of each keypoint, above 0; `outside_hidden` sets it to 0 for keypoints outside the image.
    """
    shape = pixels.shape[:3]
    noise = generator.normal(0.0, 1.0, (*shape, 2))
    fresh = np.sqrt(1.0 - detector.correlation**2)
    for t in range(1, len(noise)):
        noise[t] = detector.correlation * noise[t - 1] + fresh * noise[t]
    confidence = np.clip(generator.normal(detector.confidence, detector.confidence_sd, shape), MIN_CONFIDENCE, 1.0)
    outlier = generator.random(shape) < detector.outliers
    errors = generator.normal(0.0, detector.outlier_px, (*shape, 2))
    doubted = generator.uniform(*OUTLIER_CONFIDENCE, shape)
    reported = pixels + detector.noise_px * noise + np.where(outlier[..., None], errors, 0.0)
    return reported, np.where(outlier, doubted, confidence)


def outside_hidden(pixels: F64, confidence: F64, size: tuple[int, int]) -> tuple[F64, F64]:
    """Set keypoints outside the image, and their confidence, to 0.

    Parameters
    ----------
    pixels : float64 array (T, V, P, 2)
        Positions in the images; NaN if a keypoint has none.
    confidence : float64 array (T, V, P)
        The confidence of each keypoint.
    size : tuple of (int, int)
        Width and height of the images in pixels.

    Returns
    -------
    pixels : float64 array (T, V, P, 2)
        The positions, 0 where the keypoint is not visible.
    confidence : float64 array (T, V, P)
        The confidence, 0 where the keypoint is not visible.
    """
    inside = ((pixels >= 0.0) & (pixels < np.array(size, np.float64))).all(axis=-1)  # false for NaN
    seen = inside & (confidence > 0.0)
    return np.where(seen[..., None], pixels, 0.0), np.where(seen, confidence, 0.0)


@dataclass(frozen=True)
class CameraRing:
    """A ring of identical cameras.

    Attributes
    ----------
    count : int
        Number of cameras, 1 or more.
    distance_m : float
        Distance of the ring from the outermost position of the root, in metres.
    height_m : float
        Height of the cameras above the floor, in metres.
    aim_m : float
        Height above the floor of the point that they look at, in metres.
    focal_px : float
        Focal length in pixels.
    size : tuple of (int, int)
        Width and height of the images in pixels.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    count: int = 4
    distance_m: float = 4.0
    height_m: float = 2.2
    aim_m: float = 1.0
    focal_px: float = 1000.0
    size: tuple[int, int] = (1280, 960)

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 100:
            raise ParameterError("count", "from 1 to 100 cameras", self.count)
        for name in ("distance_m", "focal_px"):
            if not 0 < getattr(self, name) < np.inf:
                raise ParameterError(name, "above 0", getattr(self, name))
        if min(self.size) < 1:
            raise ParameterError("size", "a width and a height in pixels", self.size)

    @property
    def matrix(self) -> F64:
        """Return the camera matrix (3, 3), in pixels, that all cameras share."""
        width, height = self.size
        return np.array([[self.focal_px, 0.0, width / 2], [0.0, self.focal_px, height / 2], [0.0, 0.0, 1.0]])


def ring_of_cameras(ring: CameraRing, roots: F64, floor_m: float, generator: np.random.Generator) -> tuple[F64, F64]:
    """Place cameras evenly around the centre of a take, the first in a random direction.

    Parameters
    ----------
    ring : CameraRing
        The ring.
    roots : float64 array (T, 3)
        The body's root in metres, Y up.
    floor_m : float
        Height of the floor, in metres.
    generator : numpy.random.Generator
        The generator from which the direction of the first camera is drawn.

    Returns
    -------
    rotations : float64 array (V, 3, 3)
        Rotations R from the world to each camera, whose rows point right, down and forward.
    translations : float64 array (V, 3)
        Translations t in metres: x_camera = R · X + t.
    """
    middle = roots.mean(axis=0)
    radius = ring.distance_m + np.abs(roots[:, [0, 2]] - middle[[0, 2]]).max()
    angles = generator.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(ring.count) / ring.count
    centres = np.stack(
        [
            middle[0] + radius * np.sin(angles),
            np.full(ring.count, floor_m + ring.height_m),
            middle[2] + radius * np.cos(angles),
        ],
        axis=1,
    )
    forward = np.array([middle[0], floor_m + ring.aim_m, middle[2]]) - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotations = np.stack([right, np.cross(forward, right), forward], axis=1)
    return rotations, -np.einsum("vij,vj->vi", rotations, centres)


@dataclass(frozen=True)
class Setup:
    """The parameters of a simulated recording.

    Attributes
    ----------
    ring : CameraRing
        The cameras.
    detector : Detector
        The errors of keypoints.
    failures : FailureRate
        The frequency and duration of detector failures.
    """

    ring: CameraRing = field(default_factory=CameraRing)
    detector: Detector = field(default_factory=Detector)
    failures: FailureRate = field(default_factory=FailureRate)


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A recording with V cameras and P keypoints.

    Attributes
    ----------
    rotations, translations : float64 array (V, 3, 3), (V, 3)
        The cameras: x_camera = R · X + t, in metres.
    pixels : float64 array (T, V, P, 2)
        The keypoints; 0 for a keypoint that is not seen.
    confidence : float64 array (T, V, P)
        The confidence of each keypoint; 0 for a keypoint that is not seen.
    failures : tuple of Failure
        The failures.
    """

    rotations: F64
    translations: F64
    pixels: F64
    confidence: F64
    failures: tuple[Failure, ...]


def take_generators(seed: int, name: str) -> list[np.random.Generator]:
    """Return three independent random generators of a take, for cameras, keypoints, and failures."""
    return [np.random.default_rng(one) for one in np.random.SeedSequence([seed, zlib.crc32(name.encode())]).spawn(3)]


def simulated_recording(
    setup: Setup,
    body: ChainBody,
    positions: F64,
    points: BodyPoints,
    limbs: Limbs,
    rate_hz: float,
    generators: Sequence[np.random.Generator],
) -> SimulatedRecording:
    """Simulate a camera recording of a take.

    Parameters
    ----------
    setup : Setup
        Cameras, errors and failures.
    body : ChainBody
        The body of the take, whose chain is fitted to the take. The keypoints move with the nodes of the chain.
    positions : float64 array (J, 3, T)
        Joints of the take in metres, Y up, in the order of the chain.
    points : BodyPoints
        The keypoints.
    limbs : Limbs
        The keypoints of limbs.
    rate_hz : float
        Frames per second.
    generators : sequence of numpy.random.Generator
        The result of `take_generators`.

    Returns
    -------
    SimulatedRecording
        The recording; the same arguments give the same numbers.

    Raises
    ------
    ParameterError
        The take has no frame, or a position that is not finite.
    """
    if positions.shape[2] == 0 or not np.isfinite(positions).all():
        raise ParameterError("positions", "finite in all frames, of which there is one or more", positions.shape)
    of_cameras, of_keypoints, of_failures = generators
    places = keypoint_positions(
        body, positions, points, segment_offsets(setup.detector, len(points.nodes), of_keypoints)
    )
    root = np.ascontiguousarray(positions[body.chain.joint("root")].T)
    rotations, translations = ring_of_cameras(setup.ring, root, float(positions[:, 1].min()), of_cameras)
    seen = [
        project(setup.ring.matrix, turn, move, (), places)[0]
        for turn, move in zip(rotations, translations, strict=True)
    ]
    true = np.stack(seen, axis=1)
    pixels, confidence = detected_keypoints(setup.detector, true, of_keypoints)
    failures = draw_failures(setup.failures, len(places), rate_hz, setup.ring.count, of_failures)
    pixels, confidence = with_failures(failures, limbs, pixels, confidence, of_failures)
    pixels, confidence = outside_hidden(pixels, confidence, setup.ring.size)
    return SimulatedRecording(rotations, translations, pixels, confidence, tuple(failures))


def keypoint_positions(body: ChainBody, positions: F64, points: BodyPoints, offsets: F64) -> F64:
    """Compute the positions of keypoints.

    Parameters
    ----------
    body : ChainBody
        The body of the take.
    positions : float64 array (J, 3, T)
        The joints of the take in metres.
    points : BodyPoints
        P keypoints, each given by a joint or by a position in the frame of a node.
    offsets : float64 array (P, 3)
        Offset of each keypoint in the frame of its node, in metres.

    Returns
    -------
    float64 array (T, P, 3)
        The positions in metres.
    """
    turned = forward(body, fit_poses(body, positions))[1]
    centres = positions[list(body.chain.centres)]
    named = points.joints >= 0
    origins = np.where(named[:, None, None], positions[points.joints], centres[points.nodes])
    local = offsets + np.where(named[:, None], 0.0, points.offsets)
    places: F64 = origins.transpose(2, 0, 1) + np.einsum("tpij,pj->tpi", turned[:, points.nodes], local)
    return places
