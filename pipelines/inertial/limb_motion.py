"""Compute the limbs of a take over time; their orientations come from nodes, markers or hinges, or are unknown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.limbs import LIMBS, Limb
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.limb_orientation import (
    FULL,
    HINGE,
    NONE,
    SegmentFit,
    hinge_orientation,
    jumps,
    segment_orientation,
    unit_direction,
)
from kinedex.storage.formats.motion.segments import Segments

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

_TRUNK = {"pelvis": ("root", "lhip", "rhip"), "torso": ("chest", "neck", "lshoulder", "rshoulder")}
"""The joints used as markers of a limb of the trunk that has neither a node nor markers."""


@dataclass(frozen=True, eq=False)
class LimbMotion:
    """The motion of one limb over time.

    Attributes
    ----------
    limb : str
        Its name.
    basis : str
        The source of the orientation: full, hinge or none.
    times : float64 array (T,)
        Times from the beginning of the take, in seconds.
    orientation : float64 array (T, 4)
        Unit quaternions (w, x, y, z) from the limb's own frame to the world; NaN if unknown.
    position : float64 array (T, 3)
        The midpoint of its two joints in metres, Y up; NaN if unknown.
    direction : float64 array (T, 3)
        Unit vectors from the proximal to the distal joint; NaN if unknown.
    valid : bool array (T,)
        The frames with an orientation, or with a direction if the basis is none.
    jump : bool array (T,)
        The frames in which the limb turns faster than a person can.
    fit_m : float64 array (T,) or None
        Root mean square distance of the markers from their rigid shape, in metres; None without markers.
    """

    limb: str
    basis: str
    times: F64
    orientation: F64
    position: F64
    direction: F64
    valid: Bool
    jump: Bool
    fit_m: F64 | None = None


@dataclass(frozen=True, eq=False)
class TakeLimbs:
    """The limbs of a take.

    Attributes
    ----------
    rate_hz : float
        Frames per second of its source.
    limbs : dict of str to LimbMotion
        The limbs that are known, by name.
    lacking : dict of str to str
        Limb → the reason why it is unknown.
    remarks : tuple of str
        Sentences on limbs whose markers were not used.
    """

    rate_hz: float
    limbs: dict[str, LimbMotion]
    lacking: dict[str, str]
    remarks: tuple[str, ...] = ()


def take_limbs(segments: Segments, joints: Sequence[str], limbs: Iterable[str]) -> TakeLimbs:
    """Return the limbs of a take from the joints, node orientations and markers of its source.

    Parameters
    ----------
    segments : Segments
        Joints, node orientations and markers of the source.
    joints : sequence of str
        The named joints, in the order of the body.
    limbs : iterable of str
        The names of the limbs to return.
    """
    body = segments.body
    places = {joint: body.positions[i].T for i, joint in enumerate(joints) if joint not in body.unknown}
    times = np.arange(body.frames) / body.rate_hz
    found: dict[str, LimbMotion] = {}
    lacking: dict[str, str] = {}
    remarks: list[str] = []
    for name in limbs:
        limb = LIMBS[name]
        near, far = (places.get(joint) for joint in segments.ends.get(name, (limb.near, limb.far)))
        gap = np.full((body.frames, 3), np.nan)
        direction = unit_direction(near, far) if near is not None and far is not None else gap
        known = [place for place in (near, far) if place is not None]
        position = np.mean(known, axis=0) if known else gap
        basis, orientation, fit = _orientation(limb, segments, places, remarks)
        if basis == NONE:
            reason = _missing(limb, places, body.estimated)
            if reason:
                lacking[name] = reason
                continue
        valid = np.logical_and.reduce(np.isfinite(direction if basis == NONE else orientation), axis=1)
        jump = jumps(orientation, body.rate_hz)
        rms = None if fit is None else fit.rms_m
        found[name] = LimbMotion(name, basis, times, orientation, position, direction, valid, jump, rms)
    return TakeLimbs(body.rate_hz, found, lacking, tuple(remarks))


def _orientation(
    limb: Limb, segments: Segments, places: dict[str, F64], remarks: list[str]
) -> tuple[str, F64, SegmentFit | None]:
    """Return the basis of a limb's orientation, the orientation (T, 4), and the fit of its markers if there are any."""
    if limb.name in segments.turns:
        return FULL, segments.turns[limb.name], None
    if limb.name in segments.markers:
        try:
            fit = segment_orientation(common_markers(segments.markers[limb.name]))
            return FULL, fit.orientation, fit
        except ParameterError as fault:
            remarks.append(f"{limb.name}: {fault}")
    trunk = _TRUNK.get(limb.name, ())
    if trunk and all(joint in places for joint in trunk):
        try:
            fit = segment_orientation(np.stack([places[joint] for joint in trunk], axis=1))
            return FULL, fit.orientation, None
        except ParameterError as fault:
            remarks.append(f"{limb.name}: {fault}")
    if limb.bend is not None and all(joint in places for joint in (limb.near, limb.far, limb.bend)):
        beyond = JOINT_PARENTS[limb.bend] == limb.far
        orientation, valid = hinge_orientation(places[limb.near], places[limb.far], places[limb.bend], beyond)
        if valid.any():
            return HINGE, orientation, None
        remarks.append(f"{limb.name}: the hinge never bends by 15°, so that only its long axis is known")
    return NONE, np.full((segments.body.frames, 4), np.nan), None


def _missing(limb: Limb, places: dict[str, F64], estimated: Sequence[str]) -> str:
    """Return the reason why a limb has not even a direction; empty if it has one."""
    for joint in (limb.near, limb.far):
        if joint not in places:
            return f"the skeleton has no {joint}"
        if joint in estimated:
            return f"{joint} is estimated, and no node turns with the limb"
    return ""


def common_markers(markers: F64) -> F64:
    """Return the markers (T, M, 3) without rarely seen ones, so that at least one frame has all remaining markers.

    At least three markers are kept.
    """
    seen = np.logical_and.reduce(np.isfinite(markers), axis=2)
    kept = list(range(markers.shape[1]))
    while len(kept) > 3 and not seen[:, kept].all(axis=1).any():
        kept.remove(min(kept, key=lambda place: (int(seen[:, place].sum()), -place)))
    return np.ascontiguousarray(markers[:, kept])
