"""This module simulates a recording of a take: its cameras, its keypoints, and the failures in them."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.body.pose_fit import fit_poses
from kinedex.ops.cameras.projection import project
from kinedex.ops.errors import ParameterError
from kinedex.ops.simulation.cameras import CameraRing, ring_of_cameras
from kinedex.ops.simulation.failures import Failure, FailureRate, Limbs, draw_failures, with_failures
from kinedex.ops.simulation.keypoints import Detector, detected_keypoints, outside_hidden, segment_offsets
from kinedex.ops.tracking.observations import BodyPoints


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
        The keypoints, 0 where one is not seen.
    confidence : float64 array (T, V, P)
        Their confidence, 0 where one is not seen.
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
        The body of the take. Its chain is fitted to the take, and the keypoints move with its nodes.
    positions : float64 array (J, 3, T)
        Joints of the take in metres, Y up, in the order of the chain.
    points : BodyPoints
        The keypoints.
    limbs : Limbs
        The keypoints of limbs.
    rate_hz : float
        Frames a second.
    generators : sequence of numpy.random.Generator
        Those of `take_generators`.

    Returns
    -------
    SimulatedRecording
        The recording; the same arguments give the same numbers.

    Raises
    ------
    ParameterError
        The take has no frame, or one with a position that is not finite.
    """
    if positions.shape[2] == 0 or not np.isfinite(positions).all():
        raise ParameterError("positions", "finite in all frames, of which there is one or more", positions.shape)
    of_cameras, of_keypoints, of_failures = generators
    places = keypoint_places(body, positions, points, segment_offsets(setup.detector, len(points.nodes), of_keypoints))
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


def keypoint_places(body: ChainBody, positions: F64, points: BodyPoints, offsets: F64) -> F64:
    """Compute the positions of keypoints.

    Parameters
    ----------
    body : ChainBody
        The body of the take.
    positions : float64 array (J, 3, T)
        Its joints in metres.
    points : BodyPoints
        P keypoints: a joint, or a position in the frame of a node.
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
