"""Recognition of bodies among points: markers on anatomical landmarks, joint centres and keypoints."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.evidence import Evidence
from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, Reading, load_landmarks
from kinedex.catalog.skeletons.recognition.proportions import Proportions, check_proportions
from kinedex.catalog.skeletons.recognition.stand_ins import stand_ins
from kinedex.catalog.skeletons.skeleton_fit import Fit, Format, Mix, SkeletonMapping, axes_of_up
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.errors import SourceError

F64 = npt.NDArray[np.float64]

NAME = {True: "recognised markers", False: "recognised points"}
"""The names of mappings that are made for markers on the skin, and for joint centres."""

LEAST_CONFIDENCE = 0.5
"""A body that is less surely one is refused."""

_SIDES = ("l", "r")
_LEGS = tuple(f"{side}{part}" for side in _SIDES for part in ("hip", "knee", "ankle"))
_ARMS = tuple(f"{side}{part}" for side in _SIDES for part in ("shoulder", "elbow", "wrist"))
_ENOUGH = 3  # mixes of a joint that is never hidden
_APART = 0.04  # sizes of the body; an alternative farther off than this stands for another place
_OFF = 0.012  # sizes of the body; a stand-in for hidden markers is nearer than this
_PELVIS = ("lasis", "rasis", "lpsis", "rpsis", "sacrum", "ltrochanter", "rtrochanter", "lcrest", "rcrest")
_THORAX = ("c7", "t10", "clav", "strn", "lacromion", "racromion")
_SEGMENTS: dict[str, tuple[str, ...]] = {
    "root": _PELVIS, "lhip": _PELVIS, "rhip": _PELVIS, "neck": _THORAX, "chest": _THORAX, "lshoulder": _THORAX,
    "rshoulder": _THORAX,
    "lknee": ("lkneelat", "lkneemed", "lthigh"), "lankle": ("lanklelat", "lanklemed", "lkneelat", "lshank"),
    "rknee": ("rkneelat", "rkneemed", "rthigh"), "rankle": ("ranklelat", "ranklemed", "rkneelat", "rshank"),
}  # fmt: skip
"""Joint → landmarks that move with it."""

_AMID = 0.1  # hip widths; a point of the pelvis that is nearer to the middle of the hips is computed from them
_ROOT_UP = 0.12  # of the way from the middle of the hips to that of the shoulders; 0.06 to 0.20 in Acclaim bodies
_ROOT_BACK = 0.4  # hip widths; 0.59 to 0.87 for HDM05's actors bd, bk and dg, 0.24 for CMU's 02
_TINY = 1e-9  # of any unit: joints on each other, as no body has them, which the proportions show


@dataclass
class _Draft:
    """The joints found so far: the alternatives of each, best first, and how some of them are estimated."""

    places: dict[str, F64]
    joints: dict[str, list[Mix]] = field(default_factory=dict)
    estimated: dict[str, str] = field(default_factory=dict)
    made: dict[Mix, F64] = field(default_factory=dict)

    def at(self, mix: Mix) -> F64:
        """Return where a combination of points is in the sampled frames, (3, K)."""
        if mix not in self.made:
            self.made[mix] = mix.apply(self.places, 1.0)
        return self.made[mix]

    def set(self, joint: str, *mixes: Mix | None, how: str = "") -> None:
        """Give a joint its alternatives if it has none, and record how it is estimated."""
        found = [mix for mix in mixes if mix is not None]
        if found and joint not in self.joints:
            self.joints[joint] = found
            if how:
                self.estimated[joint] = how

    def place(self, joint: str) -> F64 | None:
        """Return where a joint is in the sampled frames, (3, K); None if it is unknown."""
        if joint not in self.joints:
            return None
        mix = self.joints[joint][0]
        if mix.of_joints:
            parts = {name: self.place(name) for name in mix.names}
            if any(part is None for part in parts.values()):
                return None
            return mix.apply({name: part for name, part in parts.items() if part is not None}, 1.0)
        return self.at(mix)


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
    evidence: Evidence, joints: tuple[str, ...], form: Format = "positions", landmarks: Landmarks | None = None
) -> Fit:
    """Return the best fit to points, however bad it is: a proposal for a person to edit.

    Parameters
    ----------
    evidence, joints, form, landmarks
        As for `recognise_points`.
    """
    return _recognised(evidence, joints, form, landmarks or load_landmarks())[0]


def _recognised(evidence: Evidence, joints: tuple[str, ...], form: Format, landmarks: Landmarks) -> tuple[Fit, str]:
    """Return the best fit, and the reason for which it is no body, or nothing."""
    reading = landmarks.read(evidence.names)
    index = {name: i for i, name in enumerate(evidence.names)}
    draft = _Draft({name: evidence.places[i] for name, i in index.items()})
    _regressions(draft, landmarks, reading, joints)
    if not reading.skin:
        _centres(draft, reading)
    _trunk(draft, reading)
    _ends(draft, reading)
    places = {joint: place for joint in joints if (place := draft.place(joint)) is not None}
    proportions = check_proportions(places)
    refusal = _refusal(draft, reading, proportions)
    axes, reasons = _upright(places, evidence)
    fit = _mapping(draft, reading, joints, axes, form).fit(index)
    counted = f"{reading.known} of {len(evidence.names)} labels name {'landmarks' if reading.skin else 'joints'}"
    found = replace(
        fit,
        estimated=dict(draft.estimated),
        reasons=(counted, *reasons, *proportions.reasons),
        confidence=proportions.confidence,
    )
    return found, f"{refusal}{_found(draft, reading, evidence)}" if refusal else ""


def _regressions(draft: _Draft, landmarks: Landmarks, reading: Reading, joints: Sequence[str]) -> None:
    """Make the joints that have regressions or centres of their own; alternatives must agree where both are seen."""
    with np.errstate(invalid="ignore", over="ignore"):
        size = _size(draft.places)
        for joint, (mixes, how) in landmarks.all_mixes(reading, joints).items():
            draft.set(joint, *_agreeing(draft, mixes, size), how=how)
    for joint, landmarks_of in _SEGMENTS.items():
        if joint in draft.joints and reading.skin:
            labels = [label for landmark in landmarks_of for label in reading.labels.get(landmark, ())]
            best, *others = draft.joints[joint]
            place = draft.place(joint)
            like = [] if place is None else stand_ins(draft.places, place, labels, _OFF * size)
            draft.joints[joint] = [best, *like, *others]


def _agreeing(draft: _Draft, mixes: Sequence[Mix], size: float) -> list[Mix]:
    """Return the mixes that are seen in some frame and lie where the first of them does.

    Of a joint that is seen in all sampled frames two alternatives are enough.
    """
    kept: list[Mix] = []
    first: F64 | None = None
    for mix in mixes:
        place = draft.at(mix)
        seen = np.isfinite(place[0] + place[1] + place[2])
        if not seen.any():
            continue
        if first is None:
            first, always = place, bool(seen.all())
        elif _length(place - first) > _APART * size:
            continue
        kept.append(mix)
        if always and len(kept) == _ENOUGH:
            break
    return kept


def _size(places: Mapping[str, F64]) -> float:
    """Return the extent of all points in a frame, the median over frames."""
    if not places:
        return float("nan")
    stacked = np.stack(list(places.values()))
    stacked = stacked[:, :, np.isfinite(stacked).any(axis=(0, 1))]
    if not stacked.size:
        return float("nan")
    return _length(np.nanmax(stacked, axis=0) - np.nanmin(stacked, axis=0))


def _one(label: str) -> Mix:
    return Mix(((label, 1.0),))


def _mean(labels: Sequence[str]) -> Mix | None:
    return Mix(tuple((label, 1.0 / len(labels)) for label in labels)) if labels else None


def _centres(draft: _Draft, reading: Reading) -> None:
    """Make root, neck, head, fingers and collar bones of a set of joint centres."""
    of = {name: labels[0] for name, labels in reading.labels.items() if name != "spine"}
    shoulders = [of[f"{side}shoulderjoint"] for side in _SIDES if f"{side}shoulderjoint" in of]
    hips = [of[f"{side}hipjoint"] for side in _SIDES if f"{side}hipjoint" in of]
    if "pelvis" in of and not _amid(draft, of["pelvis"], hips):
        draft.joints["root"] = [_one(of["pelvis"])]
    elif len(hips) == 2:
        _root_of_hips(draft, hips, shoulders)
    between = _mean(shoulders) if len(shoulders) == 2 else None
    neck = _one(of["neckjoint"]) if "neckjoint" in of else None
    thorax = _one(of["thorax"]) if "thorax" in of and _near(draft, of["thorax"], between) else None
    chosen = thorax or neck or between
    if chosen is not None:
        draft.joints["neck"] = [chosen]
        if chosen is between:
            draft.estimated["neck"] = "amid the shoulders"
    _head(draft, of)
    for side in _SIDES:
        if f"{side}collar" in of:
            draft.set(f"{side}clavicle", _one(of[f"{side}collar"]))
        knuckles = [of[f"{side}{finger}"] for finger in ("index", "pinky") if f"{side}{finger}" in of]
        draft.set(f"{side}fingers", _mean(knuckles))


def _amid(draft: _Draft, label: str, hips: Sequence[str]) -> bool:
    """Return whether a point of the pelvis is nothing but the middle of the hips."""
    if len(hips) != 2:
        return False
    left, right = (draft.places[hip] for hip in hips)
    return _length(draft.places[label] - (left + right) / 2) < _AMID * _length(left - right)


def _root_of_hips(draft: _Draft, hips: Sequence[str], shoulders: Sequence[str]) -> None:
    """Place the root above and behind the middle of the hips, where the skeletons of Acclaim files have it."""
    middle = Mix(tuple((hip, 0.5) for hip in hips))
    if len(shoulders) != 2:
        draft.joints["root"] = [middle]
        return
    up = tuple((hip, 0.5 - _ROOT_UP / 2) for hip in hips) + tuple((label, _ROOT_UP / 2) for label in shoulders)
    draft.joints["root"] = [Mix(up, plane=(hips[1], hips[0], shoulders[0]), out=-_ROOT_BACK), middle]
    draft.estimated["root"] = "above and behind the middle of the hips"


def _near(draft: _Draft, label: str, between: Mix | None) -> bool:
    """Return whether a point is nearer to the middle of the shoulders than to the root."""
    root = draft.place("root")
    if between is None or root is None:
        return True
    place = draft.places[label]
    return _length(place - between.apply(draft.places, 1.0)) < 0.35 * _length(place - root)


def _head(draft: _Draft, of: Mapping[str, str]) -> None:
    """Make head and head top of whatever points the head has; a point `head` is its top, its middle or its joint."""
    neck, root = draft.joints.get("neck"), draft.place("root")
    ears = [of[f"{side}ear"] for side in _SIDES if f"{side}ear" in of]
    eyes = [of[f"{side}eye"] for side in _SIDES if f"{side}eye" in of]
    middle = _mean(ears) if len(ears) == 2 else None
    top = _one(of["top"]) if "top" in of else None
    head = _one(of["headjoint"]) if "headjoint" in of else None
    if neck is None or root is None or neck[0].plane:
        draft.set("head", head or middle)
        draft.set("headtop", top)
        return
    base = neck[0]
    up = base.apply(draft.places, 1.0) - root
    trunk = _length(up)
    reach = 0.0
    if head is not None:
        rise = head.apply(draft.places, 1.0) - base.apply(draft.places, 1.0)
        reach = _length(rise) / trunk
        if reach > 1.0 or not _median((rise * up).sum(axis=0)) > 0.0:
            head = None  # such as the origin of a program's head segment, which is anywhere
    if head is not None and top is None and reach > 0.4:
        head, top = None, head
    face = middle or _mean(eyes) or (_one(of["nose"]) if "nose" in of else None)
    if head is None and middle is None and top is not None:
        head = _blend(base, top, 0.6)
        draft.estimated["head"] = "on the way from neck to the top"
    elif head is None and middle is None and face is not None:
        head = face
        draft.estimated["head"] = "at the face"
    head = middle or head
    if head is not None:
        draft.joints["head"] = [head]
        if top is None:
            length = _length(head.apply(draft.places, 1.0) - base.apply(draft.places, 1.0))
            if length > 0:
                top = _blend(base, head, float(np.clip(0.5 * trunk / length, 1.3, 3.0)))
                draft.estimated["headtop"] = "past the head, by the length of the trunk"
    if top is not None:
        draft.joints["headtop"] = [top]


def _blend(a: Mix, b: Mix, share: float) -> Mix:
    """Return the place so far on the way from one combination of points to another."""
    weights: dict[str, float] = {}
    for mix, part in ((a, 1.0 - share), (b, share)):
        for name, weight in mix.weights:
            weights[name] = weights.get(name, 0.0) + part * weight
    return Mix(tuple((name, round(weight, 6)) for name, weight in weights.items()))


def _trunk(draft: _Draft, reading: Reading) -> None:
    """Fill in the trunk: points of the spine by arc length, or the straight line; knees from clusters of markers."""
    for side in _SIDES:
        _knee_between_clusters(draft, reading, side)
    if "root" not in draft.joints or "neck" not in draft.joints:
        return
    spine = () if reading.skin else reading.labels.get("spine", ())
    for joint, share in (("belly", 1 / 3), ("chest", 2 / 3)):
        draft.set(joint, _along_spine(draft, spine, share))
    if "chest" in draft.joints:
        how = "" if reading.skin else "amid root and chest"
        draft.set("belly", Mix((("root", 0.5), ("chest", 0.5)), of_joints=True), how=how)
    for joint, share in (("chest", 2 / 3), ("belly", 1 / 3)):
        line = Mix((("root", round(1 - share, 6)), ("neck", round(share, 6))), of_joints=True)
        if joint not in draft.joints:
            draft.set(joint, line, how="on the line from root to neck")
        elif not draft.joints[joint][0].of_joints:
            draft.joints[joint].append(line)
    for joint, past in (("head", 0.25), ("headtop", 0.5)):
        mix = Mix((("root", -past), ("neck", 1 + past)), of_joints=True)
        draft.set(joint, mix, how="past the neck, in line with the trunk")
    for side in _SIDES:
        draft.set(f"{side}clavicle", *draft.joints["neck"])


def _along_spine(draft: _Draft, labels: Sequence[str], share: float) -> Mix | None:
    """Return the place at a share of the arc from root over the points of the spine to the neck."""
    root, neck = draft.place("root"), draft.place("neck")
    if not labels or root is None or neck is None:
        return None
    up = neck - root
    length = _length(up)
    heights = {label: _median(((draft.places[label] - root) * up).sum(axis=0)) / length**2 for label in labels}
    inner = [label for label in sorted(labels, key=lambda label: heights[label]) if 0.05 < heights[label] < 0.97]
    mixes = [draft.joints["root"][0], *map(_one, inner), draft.joints["neck"][0]]
    if not inner or any(mix.plane or mix.of_joints for mix in mixes):
        return None
    places = [mix.apply(draft.places, 1.0) for mix in mixes]
    steps = np.array([_length(b - a) for a, b in pairwise(places)])
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = share * along[-1]
    i = int(np.clip(np.searchsorted(along, at) - 1, 0, len(steps) - 1))
    part = float((at - along[i]) / steps[i]) if steps[i] else 0.0
    if min(part, 1 - part) < 0.1:
        return mixes[i + round(part)]
    return _blend(mixes[i], mixes[i + 1], round(part, 3))


def _knee_between_clusters(draft: _Draft, reading: Reading, side: str) -> None:
    """Estimate a knee without markers from those of thigh and shank, as far along the leg as knees are."""
    thigh, shank = (reading.labels.get(f"{side}{part}", ()) for part in ("thigh", "shank"))
    hip, ankle = draft.place(f"{side}hip"), draft.place(f"{side}ankle")
    if f"{side}knee" in draft.joints or not thigh or not shank or hip is None or ankle is None:
        return
    upper, lower = (np.mean([draft.places[label] for label in labels], axis=0) for labels in (thigh, shank))
    leg = _length(hip - ankle)
    down = _length(upper - hip) / leg
    up = _length(lower - ankle) / leg
    gap = max(1.0 - down - up, 0.05)
    share = float(np.clip((0.51 - down) / gap, 0.0, 1.0))
    mix = _blend(_mean(thigh) or _one(thigh[0]), _mean(shank) or _one(shank[0]), round(share, 3))
    draft.set(f"{side}knee", mix, how="between the markers of thigh and shank")


def _ends(draft: _Draft, reading: Reading) -> None:
    """Estimate the ends of limbs: fingers past the wrist, toes in front of the ankle."""
    for side in _SIDES:
        wrist, elbow = f"{side}wrist", f"{side}elbow"
        if wrist in draft.joints and elbow in draft.joints:
            mix = Mix(((elbow, -0.25), (wrist, 1.25)), of_joints=True)
            draft.set(f"{side}fingers", mix, how="past the wrist, in line with the forearm")
        if reading.skin:
            _toes_of_markers(draft, reading, side)
        _toes(draft, side)


def _toes_of_markers(draft: _Draft, reading: Reading, side: str) -> None:
    """Estimate toes in front of a marker on the ankle, as the pelvis faces."""
    parts = ("rasis", "lasis", "c7", "lacromion", f"{side}kneelat", f"{side}anklelat")
    of = {name: reading.labels[name][0] for name in parts if name in reading.labels}
    above = of.get("c7", of.get("lacromion"))
    if above is None or not {"rasis", "lasis", f"{side}kneelat", f"{side}anklelat"} <= of.keys():
        return
    knee, ankle = of[f"{side}kneelat"], of[f"{side}anklelat"]
    shank = _length(draft.places[ankle] - draft.places[knee])
    width = _length(draft.places[of["lasis"]] - draft.places[of["rasis"]])
    below = _blend(_one(knee), _one(ankle), 1.14)
    mix = replace(below, plane=(of["rasis"], of["lasis"], above), out=round(0.36 * shank / width, 4))
    draft.set(f"{side}toes", mix, how="in front of the ankle, as the pelvis faces")


def _toes(draft: _Draft, side: str) -> None:
    """Estimate toes in front of the ankle and below it, as the pelvis faces."""
    legs = [draft.joints.get(f"{side}{part}", [None])[0] for part in ("ankle", "knee")]
    ahead = [draft.joints.get(joint, [None])[0] for joint in ("rhip", "lhip", "neck")]
    if f"{side}toes" in draft.joints or any(mix is None or mix.of_joints or mix.plane for mix in (*legs, *ahead)):
        return
    ankle, knee = draft.place(f"{side}ankle"), draft.place(f"{side}knee")
    right, left, neck = (draft.place(joint) for joint in ("rhip", "lhip", "neck"))
    nodes = [mix.node for mix in ahead if mix is not None]
    if ankle is None or knee is None or right is None or left is None or neck is None or None in nodes:
        return
    shank, width = _length(ankle - knee), _length(left - right)
    below = _blend(legs[1], legs[0], 1.14)  # type: ignore[arg-type]
    plane = tuple(node for node in nodes if node is not None)
    draft.set(
        f"{side}toes",
        replace(below, plane=plane, out=round(0.36 * shank / width, 4)),
        how="in front of the ankle, as the pelvis faces",
    )


def _median(values: F64) -> float:
    """Return the median of the finite values; NaN without any."""
    ordered = np.sort(values[np.isfinite(values)])
    count = len(ordered)
    return float(ordered[(count - 1) // 2] + ordered[count // 2]) / 2 if count else float("nan")


def _length(vectors: F64) -> float:
    """Return the median length of vectors (3, K), never so near to zero that nothing can be divided by it."""
    return max(_median(np.sqrt((vectors * vectors).sum(axis=0))), _TINY)


def _upright(places: Mapping[str, F64], evidence: Evidence) -> tuple[F64, list[str]]:
    """Return the axes (3, 3) with Y up, and sentences on how they were found."""
    judged = up_axis(places)
    stated = evidence.up
    reasons = [f"up is {judged.axis or 'undecided'} by posture (confidence {judged.confidence:.2f})", *judged.reasons]
    if stated is None:
        return axes_of_up(judged.axis or "y"), reasons
    reasons = [f"the file states that {stated} is up", *reasons]
    return axes_of_up(stated), reasons


def _mapping(draft: _Draft, reading: Reading, joints: Sequence[str], axes: F64, form: Format) -> SkeletonMapping:
    """Return the mapping of a draft; joints made of joints come after those that they are made of."""
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
    """Return over how many joints a joint is made of points."""
    parts = [name for mix in made.get(joint, ()) if mix.of_joints for name in mix.names]
    return 1 + max((_depth(made, part) for part in parts), default=-1)


def _refusal(draft: _Draft, reading: Reading, proportions: Proportions) -> str:
    """Return why these points are no body, or nothing."""
    legs = [joint for joint in _LEGS if joint in draft.joints]
    arms = [joint for joint in _ARMS if joint in draft.joints]
    if not (
        len(legs) == len(_LEGS)
        or (len(arms) == len(_ARMS) and "neck" in draft.joints and {"root", "chest"} & draft.joints.keys())
    ):
        return "no human body is recognised among its points: neither two whole legs nor two arms and a trunk"
    if proportions.confidence < LEAST_CONFIDENCE:
        return f"its points have no human proportions ({'; '.join(proportions.doubts)})"
    return ""


def _found(draft: _Draft, reading: Reading, evidence: Evidence) -> str:
    """Return a clause that lists what was found and what was not, and the way out."""
    named = sorted(f"{landmark} ({', '.join(labels[:2])})" for landmark, labels in reading.labels.items())
    shown = ", ".join(named[:8]) + (f" and {len(named) - 8} more" if len(named) > 8 else "")
    unread = ", ".join(reading.unread[:8]) + (" …" if len(reading.unread) > 8 else "")
    joints = ", ".join(draft.joints) or "none"
    return (
        f"; {reading.known} of {len(evidence.names)} labels are known{': ' + shown if named else ''}"
        f"{'; not known: ' + unread if unread else ''}; joints found: {joints}; write a mapping with `kinedex mapping "
        "new FILE -o my.yaml`, complete it and give it by `skeletons`"
    )
