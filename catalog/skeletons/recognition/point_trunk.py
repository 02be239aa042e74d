"""Estimate head, trunk, feet and hands of a body among points, from the joints and landmarks that are known.

The draft of a body has the joints found so far, as combinations of points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from kinedex.catalog.skeletons.recognition.landmarks import Reading
from kinedex.catalog.skeletons.skeleton_fit import Mix
from kinedex.ops.arrays import F64

_TINY = 1e-9  # in any unit; joints this near to each other coincide, which the check of proportions reports

SIDES = ("l", "r")
"""The first letters of the joints of each side."""


@dataclass
class BodyDraft:
    """The joints found so far.

    Attributes
    ----------
    positions : dict of str to float64 array (3, K)
        The points in K sampled frames.
    joints : dict of str to list of Mix
        The alternatives of each joint, the best first.
    estimated : dict of str to str
        Joint → a phrase on how it is estimated, for the joints that are estimated.
    rough : set of str
        The joints of these whose estimate may be more than 5 cm off.
    made : dict of Mix to float64 array (3, K)
        Combinations of points that were computed before.
    """

    positions: dict[str, F64]
    joints: dict[str, list[Mix]] = field(default_factory=dict)
    estimated: dict[str, str] = field(default_factory=dict)
    rough: set[str] = field(default_factory=set)
    made: dict[Mix, F64] = field(default_factory=dict)

    def at(self, mix: Mix) -> F64:
        """Return where a combination of points is in the sampled frames, (3, K)."""
        if mix not in self.made:
            self.made[mix] = mix.apply(self.positions, 1.0)
        return self.made[mix]

    def set(self, joint: str, *mixes: Mix | None, how: str = "", rough: bool = False) -> None:
        """Set the alternatives of a joint that has none yet, and `mark` how the joint is estimated."""
        found = [mix for mix in mixes if mix is not None]
        if found and joint not in self.joints:
            self.joints[joint] = found
            self.mark(joint, how, rough)

    def mark(self, joint: str, how: str, rough: bool = False) -> None:
        """Record that a joint is estimated, and how, unless `how` is empty; `rough` marks a rough estimate."""
        if how:
            self.estimated[joint] = how
            if rough:
                self.rough.add(joint)

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


def one_point(label: str) -> Mix:
    """Return the mix that consists of one point with weight 1."""
    return Mix(((label, 1.0),))


def mean_of(labels: Sequence[str]) -> Mix | None:
    """Return the mean of points; None if there are no points."""
    return Mix(tuple((label, 1.0 / len(labels)) for label in labels)) if labels else None


def blend(a: Mix, b: Mix, share: float) -> Mix:
    """Return the combination at a fraction of the line from one combination of points to another."""
    weights: dict[str, float] = {}
    for mix, part in ((a, 1.0 - share), (b, share)):
        for name, weight in mix.weights:
            weights[name] = weights.get(name, 0.0) + part * weight
    return Mix(tuple((name, round(weight, 6)) for name, weight in weights.items()))


def median_of(values: F64) -> float:
    """Return the median of the finite values; NaN if there are none."""
    ordered = np.sort(values[np.isfinite(values)])
    count = len(ordered)
    return float(ordered[(count - 1) // 2] + ordered[count // 2]) / 2 if count else float("nan")


def median_length(vectors: F64) -> float:
    """Return the median length of vectors (3, K), at least a small positive number, so that it can be a divisor."""
    return max(median_of(np.sqrt((vectors * vectors).sum(axis=0))), _TINY)


def add_head(draft: BodyDraft, of: Mapping[str, str]) -> None:
    """Add head and head top from the points of the head; a point `head` may be its top, its middle or its joint."""
    neck, root = draft.joints.get("neck"), draft.place("root")
    ears = [of[f"{side}ear"] for side in SIDES if f"{side}ear" in of]
    eyes = [of[f"{side}eye"] for side in SIDES if f"{side}eye" in of]
    middle = mean_of(ears) if len(ears) == 2 else None
    top = one_point(of["top"]) if "top" in of else None
    head = one_point(of["headjoint"]) if "headjoint" in of else None
    if neck is None or root is None or neck[0].plane:
        draft.set("head", head or middle)
        draft.set("headtop", top)
        return
    base = neck[0]
    up = base.apply(draft.positions, 1.0) - root
    trunk = median_length(up)
    reach = 0.0
    if head is not None:
        rise = head.apply(draft.positions, 1.0) - base.apply(draft.positions, 1.0)
        reach = median_length(rise) / trunk
        if reach > 1.0 or not median_of((rise * up).sum(axis=0)) > 0.0:
            head = None  # such as the origin of a program's head segment, which is anywhere
    if head is not None and top is None and reach > 0.4:
        head, top = None, head
    face = middle or mean_of(eyes) or (one_point(of["nose"]) if "nose" in of else None)
    if head is None and middle is None and top is not None:
        head = blend(base, top, 0.6)
        draft.mark("head", "on the way from neck to the top")
    elif head is None and middle is None and face is not None:
        head = face
        draft.mark("head", "at the face", rough=True)
    head = middle or head
    if head is not None:
        draft.joints["head"] = [head]
        if top is None:
            length = median_length(head.apply(draft.positions, 1.0) - base.apply(draft.positions, 1.0))
            if length > 0:
                top = blend(base, head, float(np.clip(0.5 * trunk / length, 1.3, 3.0)))
                draft.mark("headtop", "past the head, by the length of the trunk")
    if top is not None:
        draft.joints["headtop"] = [top]


def add_trunk(draft: BodyDraft, reading: Reading) -> None:
    """Add the missing joints of the trunk, on the spine or a straight line, and knees between clusters of markers."""
    for side in SIDES:
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
            draft.set(joint, line, how="on the line from root to neck", rough=True)
        elif not draft.joints[joint][0].of_joints:
            draft.joints[joint].append(line)
    for joint, past in (("head", 0.25), ("headtop", 0.5)):
        mix = Mix((("root", -past), ("neck", 1 + past)), of_joints=True)
        draft.set(joint, mix, how="past the neck, in line with the trunk", rough=True)
    for side in SIDES:
        draft.set(f"{side}clavicle", *draft.joints["neck"])


def _along_spine(draft: BodyDraft, labels: Sequence[str], share: float) -> Mix | None:
    """Return a mix of points at a fraction of the arc length from root over the points of the spine to the neck.

    None if root, neck or points of the spine between them are missing.
    """
    root, neck = draft.place("root"), draft.place("neck")
    if not labels or root is None or neck is None:
        return None
    up = neck - root
    length = median_length(up)
    heights = {label: median_of(((draft.positions[label] - root) * up).sum(axis=0)) / length**2 for label in labels}
    inner = [label for label in sorted(labels, key=lambda label: heights[label]) if 0.05 < heights[label] < 0.97]
    mixes = [draft.joints["root"][0], *map(one_point, inner), draft.joints["neck"][0]]
    if not inner or any(mix.plane or mix.of_joints for mix in mixes):
        return None
    positions = [mix.apply(draft.positions, 1.0) for mix in mixes]
    steps = np.array([median_length(b - a) for a, b in pairwise(positions)])
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = share * along[-1]
    i = int(np.clip(np.searchsorted(along, at) - 1, 0, len(steps) - 1))
    part = float((at - along[i]) / steps[i]) if steps[i] else 0.0
    if min(part, 1 - part) < 0.1:
        return mixes[i + round(part)]
    return blend(mixes[i], mixes[i + 1], round(part, 3))


def _knee_between_clusters(draft: BodyDraft, reading: Reading, side: str) -> None:
    """Estimate a knee without markers from the markers of thigh and shank, at a knee's usual place along the leg."""
    thigh, shank = (reading.labels.get(f"{side}{part}", ()) for part in ("thigh", "shank"))
    hip, ankle = draft.place(f"{side}hip"), draft.place(f"{side}ankle")
    if f"{side}knee" in draft.joints or not thigh or not shank or hip is None or ankle is None:
        return
    upper, lower = (np.mean([draft.positions[label] for label in labels], axis=0) for labels in (thigh, shank))
    leg = median_length(hip - ankle)
    down = median_length(upper - hip) / leg
    up = median_length(lower - ankle) / leg
    gap = max(1.0 - down - up, 0.05)
    share = float(np.clip((0.51 - down) / gap, 0.0, 1.0))
    mix = blend(mean_of(thigh) or one_point(thigh[0]), mean_of(shank) or one_point(shank[0]), round(share, 3))
    draft.set(f"{side}knee", mix, how="between the markers of thigh and shank", rough=True)


def add_ends(draft: BodyDraft, reading: Reading) -> None:
    """Estimate the ends of limbs: fingers past the wrist, toes in front of the ankle."""
    for side in SIDES:
        wrist, elbow = f"{side}wrist", f"{side}elbow"
        if wrist in draft.joints and elbow in draft.joints:
            mix = Mix(((elbow, -0.25), (wrist, 1.25)), of_joints=True)
            draft.set(f"{side}fingers", mix, how="past the wrist, in line with the forearm", rough=True)
        if reading.skin:
            _toes_of_markers(draft, reading, side)
        _toes(draft, side)


def _toes_of_markers(draft: BodyDraft, reading: Reading, side: str) -> None:
    """Estimate the toes in front of a marker on the ankle, in the direction that the pelvis faces."""
    parts = ("rasis", "lasis", "c7", "lacromion", f"{side}kneelat", f"{side}anklelat")
    of = {name: reading.labels[name][0] for name in parts if name in reading.labels}
    above = of.get("c7", of.get("lacromion"))
    if above is None or not {"rasis", "lasis", f"{side}kneelat", f"{side}anklelat"} <= of.keys():
        return
    knee, ankle = of[f"{side}kneelat"], of[f"{side}anklelat"]
    shank = median_length(draft.positions[ankle] - draft.positions[knee])
    width = median_length(draft.positions[of["lasis"]] - draft.positions[of["rasis"]])
    below = blend(one_point(knee), one_point(ankle), 1.14)
    mix = replace(below, plane=(of["rasis"], of["lasis"], above), out=round(0.36 * shank / width, 4))
    draft.set(f"{side}toes", mix, how="in front of the ankle, as the pelvis faces", rough=True)


def _toes(draft: BodyDraft, side: str) -> None:
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
    shank, width = median_length(ankle - knee), median_length(left - right)
    below = blend(legs[1], legs[0], 1.14)  # type: ignore[arg-type]
    plane = tuple(node for node in nodes if node is not None)
    draft.set(
        f"{side}toes",
        replace(below, plane=plane, out=round(0.36 * shank / width, 4)),
        how="in front of the ankle, as the pelvis faces",
        rough=True,
    )
