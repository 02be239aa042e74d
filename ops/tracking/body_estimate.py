"""This module estimates a person's bone lengths from triangulated keypoints and an archive's mean body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.facing_direction import mirrored_names
from kinedex.ops.body.kinematic_chain import ChainBody, KinematicChain
from kinedex.ops.errors import KinedexError, ParameterError, Remedy

MIN_CAMERAS = 3
"""Number of cameras that must see both ends of a bone in a frame; 2 if no frame has three."""

UNEVEN = 1.1
"""Ratio of left and right bone lengths, or its inverse, above which the difference is reported."""

TRUNK_M = (0.2, 0.9)
"""Minimum and maximum plausible distance in metres between the midpoints of hips and shoulders."""

_UNITS = {"mm": 0.001, "cm": 0.01, "in": 0.0254, "ft": 0.3048, "dm": 0.1, "km": 1000.0}
_USUAL_M = 0.5
_LIMBS = (("elbow", "wrist", "fingers"), ("knee", "ankle", "toes"))
"""The bones of an arm and of a leg, by the joints at their ends, without the side."""


@dataclass(frozen=True)
class SideLengths:
    """The lengths of a bone on either side.

    Attributes
    ----------
    joint : str
        The joint at the end of the bone, without the side: `knee` for the thighs.
    left_m, right_m : float
        Median lengths in metres; NaN if a side is not seen.
    frames : int
        The number of frames in which a side is seen; if both are seen, the smaller number.
    """

    joint: str
    left_m: float
    right_m: float
    frames: int

    @property
    def ratio(self) -> float:
        """Return the ratio of the longer to the shorter length; NaN if a side is not seen."""
        low, high = sorted((self.left_m, self.right_m))
        return high / low if low > 0 else np.inf if low == 0 else np.nan


@dataclass(frozen=True, eq=False)
class BodyEstimate:
    """The estimated body of a person in a recording.

    Attributes
    ----------
    body : ChainBody
        The chain with the person's lengths.
    sides : tuple of SideLengths
        The bones that keypoints determine.
    scaled : tuple of str
        The joints at the ends of bones without keypoints, whose lengths are those of the mean body, scaled.
    trunk_m : float
        Distance in metres between the midpoints of hips and shoulders.
    cameras : int
        The number of cameras that had to see a point, 3 or 2.
    """

    body: ChainBody
    sides: tuple[SideLengths, ...]
    scaled: tuple[str, ...]
    trunk_m: float
    cameras: int

    @property
    def uneven(self) -> tuple[SideLengths, ...]:
        """Return the bones whose sides differ by more than a tenth, due to confused keypoints or bad calibration."""
        return tuple(bone for bone in self.sides if bone.ratio > UNEVEN)


def mean_body(chain: KinematicChain, bodies: Sequence[ChainBody]) -> ChainBody:
    """Return the mean of several bodies, with equal lengths on both sides.

    Raises
    ------
    ParameterError
        `bodies` is empty.
    """
    if not bodies:
        raise ParameterError("bodies", "those of one actor at least", "none")
    offsets = np.mean([body.offsets for body in bodies], axis=0)
    mirrored = offsets[[chain.joint(name) for name in mirrored_names(chain.joints)]] * (-1.0, 1.0, 1.0)
    return ChainBody(chain, 0.5 * (offsets + mirrored))


def estimate_body(
    chain: KinematicChain, points: F64, cameras: I64, joints: I64, archive_mean: ChainBody
) -> BodyEstimate:
    """Estimate the bone lengths of a person from keypoints.

    The length of a bone is the median over frames in which both of its ends are seen by three cameras, averaged over
    both sides of the body. Two cameras suffice if hips and shoulders are seen by three cameras in no frame. If the
    sides differ by more than a tenth, the length nearer to the scaled mean body is used. Hips and shoulders lie at half
    their distance from their midpoint. Bones without keypoints have the lengths of the mean body, scaled like the arms,
    the legs, or the trunk.

    Parameters
    ----------
    chain : KinematicChain
        The chain, with the joint names of the shipped chain.
    points : float64 array (T, P, 3)
        Triangulated keypoints in metres; NaN if there is none.
    cameras : int64 array (T, P)
        The number of cameras from which each keypoint was triangulated.
    joints : int64 array (P,)
        The joint that each keypoint coincides with, −1 for none.
    archive_mean : ChainBody
        The mean body, see `mean_body`.

    Returns
    -------
    BodyEstimate
        The body.

    Raises
    ------
    ParameterError
        Hips and shoulders are not among the keypoints, or are never seen together by two cameras; or shapes do not
        agree.
    KinedexError
        The distance of hips and shoulders is implausible for a body; the message suggests a unit that would explain it.
    """
    frames, count = cameras.shape
    if points.shape != (frames, count, 3) or joints.shape != (count,):
        raise ParameterError("points", f"of shape ({frames}, {len(joints)}, 3)", points.shape)
    least, positions = _places(chain, points, cameras, joints)
    trunk_m = _trunk(chain, positions, least)
    mean = {name: float(np.sqrt((archive_mean.offsets[j] ** 2).sum())) for j, name in enumerate(chain.joints)}
    # at rest the shoulders are as high as the neck
    rest = (
        mean["belly"]
        + mean["chest"]
        + mean["neck"]
        - 0.5 * float(archive_mean.offsets[chain.joint("lhip"), 1] + archive_mean.offsets[chain.joint("rhip"), 1])
    )
    share = trunk_m / rest
    offsets = share * archive_mean.offsets
    for pair in (("lhip", "rhip"), ("lshoulder", "rshoulder")):
        width, _ = _median_length(positions, *pair)
        for name in pair:
            offsets[chain.joint(name), 0] = np.sign(offsets[chain.joint(name), 0]) * 0.5 * width
    sides, scaled = [], [name for name in chain.joints if name[1:] not in {*_LIMBS[0], *_LIMBS[1], "hip", "shoulder"}]
    for limb in _LIMBS:
        bones = [_sides(chain, positions, bone) for bone in limb]
        lengths = _limb_lengths(limb, bones, mean, share)
        for bone, found in zip(limb, bones, strict=True):
            for name in (f"l{bone}", f"r{bone}"):
                j = chain.joint(name)
                offsets[j] = archive_mean.offsets[j] * (lengths[bone] / mean[name] if mean[name] > 0 else 0.0)
            if found is None:
                scaled += [f"l{bone}", f"r{bone}"]
            else:
                sides.append(found)
    unseen = tuple(name for name in chain.joints if name in scaled and chain.rest[chain.joint(name)].along is not None)
    return BodyEstimate(ChainBody(chain, offsets), tuple(sides), unseen, trunk_m, least)


def _places(chain: KinematicChain, points: F64, cameras: I64, joints: I64) -> tuple[int, dict[str, F64]]:
    """Return how many cameras must see a point (3 or 2), and the positions (T, 3) of the joints that are keypoints."""
    trunk = [chain.joint(name) for name in ("lhip", "rhip", "lshoulder", "rshoulder")]
    columns = {int(joint): p for p, joint in reversed(list(enumerate(joints))) if joint >= 0}
    missing = [chain.joints[joint] for joint in trunk if joint not in columns]
    if missing:
        raise ParameterError("joints", "with both hips and both shoulders", f"none that is {missing[0]}")
    together = cameras[:, [columns[joint] for joint in trunk]].min(axis=1)
    least = MIN_CAMERAS if (together >= MIN_CAMERAS).any() else 2
    if not (together >= least).any():
        message = "hips and shoulders seen together by two cameras in a frame at least"
        raise ParameterError("points", message, "none; give `body: <take>`, a take of the person in the archive")
    seen = np.where((cameras >= least)[:, :, None], points, np.nan)
    return least, {chain.joints[joint]: seen[:, p] for joint, p in columns.items()}


def _trunk(chain: KinematicChain, positions: dict[str, F64], least: int) -> float:
    """Return the distance between the midpoints of hips and shoulders; raise an error if it is implausible."""
    apart = 0.5 * (positions["lshoulder"] + positions["rshoulder"] - positions["lhip"] - positions["rhip"])
    found = float(np.nanmedian(np.sqrt((apart**2).sum(axis=1))))
    if TRUNK_M[0] <= found <= TRUNK_M[1]:
        return found
    near = {unit: abs(np.log(found * metres / _USUAL_M)) for unit, metres in _UNITS.items()} if found > 0 else {}
    guess = min(near, key=lambda unit: near[unit], default="")
    way_out = "no usual unit explains it: check the calibration and the order of the cameras"
    if guess and TRUNK_M[0] <= found * _UNITS[guess] <= TRUNK_M[1]:
        way_out = f"the calibration seems to be in {guess}: set `unit: {guess}` for the recording"
    raise KinedexError(
        f"hips and shoulders are {found:.4g} m apart, and {TRUNK_M[0]} to {TRUNK_M[1]} m on a person",
        remedy=Remedy(way_out),
    )


def _median_length(positions: dict[str, F64], one: str, other: str) -> tuple[float, int]:
    """Return the median distance of two joints, NaN if they are never seen together, and the number of frames."""
    if one not in positions or other not in positions:
        return np.nan, 0
    lengths = np.sqrt(((positions[one] - positions[other]) ** 2).sum(axis=1))
    lengths = lengths[np.isfinite(lengths)]
    return (float(np.median(lengths)), len(lengths)) if len(lengths) else (np.nan, 0)


def _sides(chain: KinematicChain, positions: dict[str, F64], bone: str) -> SideLengths | None:
    """Return the lengths of a bone on both sides; None if no keypoints determine it."""
    (left, count), (right, counted) = (
        _median_length(positions, f"{side}{bone}", chain.joints[chain.rest[chain.joint(f"{side}{bone}")].start])
        for side in "lr"
    )
    counts = [number for number in (count, counted) if number]
    return SideLengths(bone, left, right, min(counts)) if counts else None


def _limb_lengths(
    limb: tuple[str, ...], bones: list[SideLengths | None], mean: dict[str, float], share: float
) -> dict[str, float]:
    """Return the lengths of a limb's bones; unseen bones have the mean body's length, scaled like the seen bones."""
    expected = {bone: 0.5 * (mean[f"l{bone}"] + mean[f"r{bone}"]) for bone in limb}
    even = [found for found in bones if found is not None and not found.ratio > UNEVEN]
    measured = sum(np.nanmean((found.left_m, found.right_m)) for found in even)
    usual = sum(expected[found.joint] for found in even)
    share = float(measured / usual) if usual > 0 else share
    lengths = {}
    for bone, found in zip(limb, bones, strict=True):
        usual = share * expected[bone]
        if found is None:
            lengths[bone] = usual
        elif found.ratio > UNEVEN:
            lengths[bone] = min((found.left_m, found.right_m), key=lambda one: abs(one - usual))
        else:
            lengths[bone] = float(np.nanmean((found.left_m, found.right_m)))
    return lengths
