"""Recognition of bodies among points: markers on anatomical landmarks, joint centres and keypoints.

A recognised body is checked against human proportions: lengths of limbs, their symmetry and their constancy.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.recognition.exchanged_labels import exchanged_labels
from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, Reading, load_landmarks
from kinedex.catalog.skeletons.recognition.named_points import named_reading, set_named_joints
from kinedex.catalog.skeletons.recognition.point_centres import add_centres, add_regressions
from kinedex.catalog.skeletons.recognition.point_trunk import SIDES, BodyDraft, add_ends, add_trunk, median_length
from kinedex.catalog.skeletons.skeleton_fit import Fit, Format, Mix, SkeletonMapping, axes_of_up
from kinedex.ops.arrays import F64
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.errors import SourceError

NAME = {True: "recognised markers", False: "recognised points"}
"""The names of mappings that are made for markers on the skin, and for joint centres."""

MIN_CONFIDENCE = 0.5
"""Minimum confidence at which a recognised body is accepted."""

_WHOLE_LIMBS = tuple(
    tuple(f"{side}{part}" for part in parts)
    for parts in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))
    for side in SIDES
)
_LEGS = _WHOLE_LIMBS[0] + _WHOLE_LIMBS[1]

_LIMBS = {
    "thigh": ("hip", "knee"), "shank": ("knee", "ankle"),
    "upper arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"),
}  # fmt: skip
_RATIOS = {  # shares of the leg, from hip over knee to ankle
    "thigh": (0.32, 0.68), "shank": (0.32, 0.68), "upper arm": (0.2, 0.6), "forearm": (0.17, 0.55),
    "trunk": (0.3, 1.15), "hips": (0.06, 0.55), "shoulders": (0.2, 0.8),
}  # fmt: skip
_UNEQUAL = 1.35  # largest ratio of the lengths of left and right limbs
_LOOSE = 0.15  # largest variation of a limb's length, as a share of it
_ARM_JOINTS = 1.5  # length of a leg, if it is unknown, as a multiple of an arm's to the wrist
_COST = 0.3  # confidence that each doubt subtracts


def recognise_points(
    source: str | Path,
    evidence: Evidence,
    joints: tuple[str, ...],
    form: Format = "positions",
    landmarks: Landmarks | None = None,
) -> Fit:
    """Recognise the body of a file of points by labels, proportions and posture.

    Parameters
    ----------
    source : str or Path
        The file that errors name.
    evidence : Evidence
        Labels of the points, and where they are in some frames.
    joints : tuple of str
        The named joints.
    form : str
        The format of the file, for which the mapping is made.
    landmarks : Landmarks, optional
        The labels of landmarks, `configs/names/landmarks.yaml` by default.

    Returns
    -------
    Fit
        A mapping made for this file, with the joints that are estimated, reasons and a confidence.

    Raises
    ------
    SourceError
        The points are no human body, or too few of their labels are known; the message lists what was found.
    """
    fit, refusal = _recognised(evidence, joints, form, landmarks or load_landmarks())
    if refusal:
        raise SourceError(source, refusal)
    return fit


def propose_points(
    evidence: Evidence,
    joints: tuple[str, ...],
    form: Format = "positions",
    landmarks: Landmarks | None = None,
    named: Mapping[str, str] | None = None,
) -> Fit:
    """Return the best fit to points, however bad it is: a proposal for a person to edit.

    Parameters
    ----------
    evidence, joints, form, landmarks
        As for `recognise_points`.
    named : mapping of str to str, optional
        Label → joint or landmark that a person has named (`recognition.named_points`), whatever the label says.
    """
    return _recognised(evidence, joints, form, landmarks or load_landmarks(), named)[0]


def doubted_labels(fit: Fit, evidence: Evidence, joints: tuple[str, ...], landmarks: Landmarks | None = None) -> Fit:
    """Return the fit of a mapping to points, with a warning if two of their labels seem to be exchanged.

    Parameters
    ----------
    fit : Fit
        The fit of a mapping whose names all occur.
    evidence, joints, landmarks
        As for `recognise_points`.
    """
    return replace(fit, doubts=propose_points(evidence, joints, fit.mapping.format, landmarks).doubts)


@np.errstate(over="ignore", invalid="ignore")  # Absurd numbers are refused later.
def _recognised(
    evidence: Evidence,
    joints: tuple[str, ...],
    form: Format,
    landmarks: Landmarks,
    named: Mapping[str, str] | None = None,
) -> tuple[Fit, str]:
    """Return the best fit, and the reason why the points are no body; the reason is empty if they are one."""
    index = {name: i for i, name in enumerate(evidence.names)}
    draft = BodyDraft({name: evidence.positions[i] for name, i in index.items()})
    reading = landmarks.read(evidence.names)
    if named:
        reading = named_reading(reading, landmarks, named)
    if reading.arm:
        reading = reading.with_arm(_side_of_arm(reading, draft))
    add_regressions(draft, landmarks, reading, joints)
    if not reading.skin:
        add_centres(draft, reading)
    set_named_joints(draft, named or {}, joints)
    add_trunk(draft, reading)
    add_ends(draft, reading)
    positions = {joint: place for joint in joints if (place := draft.place(joint)) is not None}
    proportions = check_proportions(positions)
    refusal = _refusal(draft, reading, proportions)
    axes, reasons = _upright(positions, evidence)
    fit = _mapping(draft, reading, joints, axes, form).fit(index)
    counted = f"{reading.known} of {len(evidence.names)} labels name {'landmarks' if reading.skin else 'joints'}"
    found = replace(
        fit,
        estimated=dict(draft.estimated),
        rough=tuple(joint for joint in draft.estimated if joint in draft.rough),
        reasons=(counted, *reasons, *proportions.reasons),
        doubts=tuple(exchanged_labels(draft, reading, proportions.leg)),
        confidence=proportions.confidence,
    )
    return found, f"{refusal}{_found(draft, reading, evidence)}" if refusal else ""


def _side_of_arm(reading: Reading, draft: BodyDraft) -> str:
    """Return the side of an arm whose labels do not state it: that on which the pelvis is nearer to its shoulder."""
    shoulder = draft.positions[reading.arm.get("acromion", next(iter(reading.arm.values())))]
    away = {}
    for side in SIDES:
        pelvis = [draft.positions[reading.labels[f"{side}{part}"][0]] for part in ("asis", "psis")
                  if f"{side}{part}" in reading.labels]  # fmt: skip
        away[side] = float(np.mean([median_length(point - shoulder) for point in pelvis])) if pelvis else np.inf
    return min(SIDES, key=lambda side: away[side])


def _upright(positions: Mapping[str, F64], evidence: Evidence) -> tuple[F64, list[str]]:
    """Return the axes (3, 3) with Y up, and sentences on how they were found."""
    judged = up_axis(positions)
    stated = evidence.up
    reasons = [f"up is {judged.axis or 'undecided'} by posture (confidence {judged.confidence:.2f})", *judged.reasons]
    if stated is None:
        return axes_of_up(judged.axis or "y"), reasons
    reasons = [f"the file states that {stated} is up", *reasons]
    return axes_of_up(stated), reasons


def _mapping(draft: BodyDraft, reading: Reading, joints: Sequence[str], axes: F64, form: Format) -> SkeletonMapping:
    """Return the mapping of a draft; joints that are combined from other joints come after these."""
    made = {joint: draft.joints[joint] for joint in draft.joints}
    order = sorted(made, key=lambda joint: _depth(made, joint))
    choices: dict[str, tuple[Mix | None, ...]] = {joint: tuple(made[joint]) for joint in order}
    choices |= {joint: (None,) for joint in joints if joint not in made}
    digest = hashlib.sha256(repr((sorted(choices.items()), axes.tolist())).encode()).hexdigest()[:16]
    return SkeletonMapping(
        name=NAME[reading.skin],
        path=Path("configs/names/landmarks.yaml"),
        digest=digest,
        format=form,
        unit_m=None,
        axes=axes,
        root_axes=axes,
        strip_prefix=None,
        bones={},
        joints=choices,
    )


def _depth(made: Mapping[str, Sequence[Mix]], joint: str) -> int:
    """Return how many steps a joint is away from points, as joints can be computed from other joints."""
    parts = [name for mix in made.get(joint, ()) if mix.of_joints for name in mix.names]
    return 1 + max((_depth(made, part) for part in parts), default=-1)


def _refusal(draft: BodyDraft, reading: Reading, proportions: Proportions) -> str:
    """Return the reason why these points are no body; the reason is empty if they are one."""
    limbs = [limb for limb in _WHOLE_LIMBS if set(limb) <= draft.joints.keys()]
    trunk = "neck" in draft.joints and {"root", "chest"} & draft.joints.keys()
    if not (set(_LEGS) <= draft.joints.keys() or (limbs and trunk)):
        return "no human body is recognised among its points: neither two whole legs nor a whole limb and a trunk"
    if proportions.confidence < MIN_CONFIDENCE:
        return f"its points have no human proportions ({'; '.join(proportions.doubts)})"
    return ""


def _found(draft: BodyDraft, reading: Reading, evidence: Evidence) -> str:
    """Return a clause that lists known labels, unknown labels and the joints found, and suggests a remedy."""
    named = sorted(f"{landmark} ({', '.join(labels[:2])})" for landmark, labels in reading.labels.items())
    shown = ", ".join(named[:8]) + (f" and {len(named) - 8} more" if len(named) > 8 else "")
    unread = ", ".join(reading.unread[:8]) + (" …" if len(reading.unread) > 8 else "")
    joints = ", ".join(draft.joints) or "none"
    return (
        f"; {reading.known} of {len(evidence.names)} labels are known{': ' + shown if named else ''}"
        f"{'; not known: ' + unread if unread else ''}; joints found: {joints}; write a mapping with `kinedex mapping "
        "new FILE -o my.yaml`, complete it and give it by `skeletons`"
    )


@dataclass(frozen=True)
class Proportions:
    """The proportions of a body.

    Attributes
    ----------
    confidence : float
        The confidence that the points form a human body, from 0 to 1.
    doubts : tuple of str
        Phrases on proportions that are not human.
    reasons : tuple of str
        Sentences for `kinedex inspect`.
    leg : float
        Length of a leg, measured or estimated from other limbs; 0 if no limb can be measured.
    """

    confidence: float
    doubts: tuple[str, ...]
    reasons: tuple[str, ...]
    leg: float


def check_proportions(positions: Mapping[str, F64]) -> Proportions:
    """Compare the limbs of a body with human ones.

    Parameters
    ----------
    positions : Mapping of str to float64 array (3, K)
        Named joints in K sampled frames, in any unit and axes; NaN where a joint is not seen.
    """
    lengths: dict[str, list[float]] = {}
    doubts: list[str] = []
    for limb, (top, end) in _LIMBS.items():
        both = [_lengths(positions, f"{side}{top}", f"{side}{end}") for side in "lr"]
        medians = [float(np.median(found)) for found in both if len(found)]
        lengths[limb] = medians
        if len(medians) == 2 and max(medians) > _UNEQUAL * max(min(medians), 1e-12):
            doubts.append(f"left and right {limb} differ by {max(medians) / max(min(medians), 1e-12):.2f}")
        loose = [_spread(found) for found in both if len(found) > 2]
        if loose and max(loose) > _LOOSE:
            doubts.append(f"the {limb} varies by {100 * max(loose):.0f} % of its length")
    for part, ends in {
        "trunk": ("root", "neck"),
        "hips": ("lhip", "rhip"),
        "shoulders": ("lshoulder", "rshoulder"),
    }.items():
        found = _lengths(positions, *ends)
        lengths[part] = [float(np.median(found))] if len(found) else []
    legs = sum(float(np.mean(lengths[limb])) for limb in ("thigh", "shank") if lengths[limb])
    arms = sum(float(np.mean(lengths[limb])) for limb in ("upper arm", "forearm") if lengths[limb])
    unit = legs if lengths["thigh"] and lengths["shank"] else 2.0 * float(np.mean(lengths["trunk"] or [0.0]))
    unit = unit or _ARM_JOINTS * arms
    shares = []
    for part, (least, most) in _RATIOS.items():
        if lengths[part] and unit > 0:
            share = float(np.mean(lengths[part])) / unit
            shares.append(f"{part} {share:.2f}")
            if not least <= share <= most:
                doubts.append(f"{part} {share:.2f} legs")
    if not unit > 0:
        doubts += ["no length"] * 3
    confidence = max(0.0, 1.0 - _COST * len(doubts))
    text = f"in lengths of a leg: {', '.join(shares)}" if shares else "no limb can be measured"
    return Proportions(confidence, tuple(doubts), (text, *doubts), unit)


def _lengths(positions: Mapping[str, F64], a: str, b: str) -> F64:
    if a not in positions or b not in positions:
        return np.empty(0)
    with np.errstate(invalid="ignore", over="ignore"):
        found = np.sqrt(((positions[a] - positions[b]) ** 2).sum(axis=0))
    return np.asarray(found[np.isfinite(found)])


def _spread(lengths: F64) -> float:
    """Return half the interquartile range of lengths divided by their median."""
    low, middle, high = np.percentile(lengths, [25, 50, 75])
    return float((high - low) / max(middle, 1e-12) / 2)
