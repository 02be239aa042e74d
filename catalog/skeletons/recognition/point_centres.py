"""Estimate joints of a body among points, from regressions of landmarks or from points at the joints' centres.

A joint with hidden markers is estimated from three other markers of its segment, learned where all are visible.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, Reading
from kinedex.catalog.skeletons.recognition.point_trunk import (
    SIDES,
    BodyDraft,
    add_head,
    mean_of,
    median_length,
    one_point,
)
from kinedex.catalog.skeletons.skeleton_fit import Mix
from kinedex.ops.arrays import F64

_ENOUGH = 3  # most mixes of a joint that is never hidden
_APART = 0.04  # share of the body's size; alternatives farther apart than this are of different places
_OFF = 0.012  # share of the body's size; largest error of a stand-in for hidden markers
_PELVIS = ("lasis", "rasis", "lpsis", "rpsis", "sacrum", "ltrochanter", "rtrochanter", "lcrest", "rcrest")
_THORAX = ("c7", "t10", "clav", "strn", "lacromion", "racromion")

_SEGMENTS: dict[str, tuple[str, ...]] = {
    "root": _PELVIS, "lhip": _PELVIS, "rhip": _PELVIS, "neck": _THORAX, "chest": _THORAX, "lshoulder": _THORAX,
    "rshoulder": _THORAX,
    "lknee": ("lkneelat", "lkneemed", "lthigh"), "lankle": ("lanklelat", "lanklemed", "lkneelat", "lshank"),
    "rknee": ("rkneelat", "rkneemed", "rthigh"), "rankle": ("ranklelat", "ranklemed", "rkneelat", "rshank"),
}  # fmt: skip
"""A dict from joint to landmarks that move with it."""

_AMID = 0.1  # hip widths; a pelvis point nearer than this to the middle of the hips was computed from them
_ROOT_UP = 0.12  # share of the way from mid-hips to mid-shoulders; 0.06 to 0.20 in Acclaim bodies
_ROOT_BACK = 0.4  # hip widths; 0.59 to 0.87 for HDM05's actors bd, bk and dg, 0.24 for CMU's 02

_MAX_STAND_INS = 6  # most stand-ins of a joint
_MAX_LABELS = 6  # most labels of a segment; more make no better triples
_FARTHEST = 2.0  # largest coordinate of a joint in the axes of a triple; beyond, it amplifies marker noise too much
_FLAT = 0.05  # sine of an angle below which three markers lie on a line


def add_regressions(draft: BodyDraft, landmarks: Landmarks, reading: Reading, joints: Sequence[str]) -> None:
    """Add the joints with regressions or centres; alternatives must agree in frames where both are visible."""
    with np.errstate(invalid="ignore", over="ignore"):
        size = _size(draft.positions)
        for joint, mixes in landmarks.all_mixes(reading, joints).items():
            kept = _agreeing(draft, mixes, size)
            if kept:
                choice = mixes[kept[0]]
                draft.set(joint, *kept, how=choice.estimated, rough=choice.rough)
    for joint, landmarks_of in _SEGMENTS.items():
        if joint in draft.joints and reading.skin:
            labels = [label for landmark in landmarks_of for label in reading.labels.get(landmark, ())]
            best, *others = draft.joints[joint]
            place = draft.place(joint)
            like = [] if place is None else stand_ins(draft.positions, place, labels, _OFF * size)
            draft.joints[joint] = [best, *like, *others]


def _agreeing(draft: BodyDraft, mixes: Iterable[Mix], size: float) -> list[Mix]:
    """Return the mixes that are visible in some frame and agree with the position of the first one.

    If the first mix is visible in all sampled frames, few alternatives are kept.
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
        elif median_length(place - first) > _APART * size:
            continue
        kept.append(mix)
        if always and len(kept) == _ENOUGH:
            break
    return kept


def _size(positions: Mapping[str, F64]) -> float:
    """Return the extent of all points in a frame, the median over frames."""
    if not positions:
        return float("nan")
    stacked = np.stack(list(positions.values()))
    stacked = stacked[:, :, np.isfinite(stacked).any(axis=(0, 1))]
    if not stacked.size:
        return float("nan")
    return median_length(np.nanmax(stacked, axis=0) - np.nanmin(stacked, axis=0))


def add_centres(draft: BodyDraft, reading: Reading) -> None:
    """Add root, neck, head, fingers and collar bones from a set of joint centres."""
    of = {name: labels[0] for name, labels in reading.labels.items() if name != "spine"}
    shoulders = [of[f"{side}shoulderjoint"] for side in SIDES if f"{side}shoulderjoint" in of]
    hips = [of[f"{side}hipjoint"] for side in SIDES if f"{side}hipjoint" in of]
    if "pelvis" in of and not _amid(draft, of["pelvis"], hips):
        draft.joints["root"] = [one_point(of["pelvis"])]
    elif len(hips) == 2:
        _root_of_hips(draft, hips, shoulders)
    between = mean_of(shoulders) if len(shoulders) == 2 else None
    neck = one_point(of["neckjoint"]) if "neckjoint" in of else None
    thorax = one_point(of["thorax"]) if "thorax" in of and is_near(draft, of["thorax"], between) else None
    chosen = thorax or neck or between
    if chosen is not None:
        draft.joints["neck"] = [chosen]
        if chosen is between:
            draft.mark("neck", "amid the shoulders", rough=True)
    add_head(draft, of)
    for side in SIDES:
        if f"{side}collar" in of:
            draft.set(f"{side}clavicle", one_point(of[f"{side}collar"]))
        knuckles = [of[f"{side}{finger}"] for finger in ("index", "pinky") if f"{side}{finger}" in of]
        draft.set(f"{side}fingers", mean_of(knuckles))


def _amid(draft: BodyDraft, label: str, hips: Sequence[str]) -> bool:
    """Return whether a point of the pelvis is merely the middle of the hips."""
    if len(hips) != 2:
        return False
    left, right = (draft.positions[hip] for hip in hips)
    return median_length(draft.positions[label] - (left + right) / 2) < _AMID * median_length(left - right)


def _root_of_hips(draft: BodyDraft, hips: Sequence[str], shoulders: Sequence[str]) -> None:
    """Place the root above and behind the middle of the hips, where the skeletons of Acclaim files have it."""
    middle = Mix(tuple((hip, 0.5) for hip in hips))
    if len(shoulders) != 2:
        draft.set("root", middle, how="amid the hips", rough=True)
        return
    up = tuple((hip, 0.5 - _ROOT_UP / 2) for hip in hips) + tuple((label, _ROOT_UP / 2) for label in shoulders)
    draft.joints["root"] = [Mix(up, plane=(hips[1], hips[0], shoulders[0]), out=-_ROOT_BACK), middle]
    draft.mark("root", "above and behind the middle of the hips")


def is_near(draft: BodyDraft, label: str, between: Mix | None) -> bool:
    """Return whether a point is much nearer to the middle of the shoulders than to the root, or one is unknown."""
    root = draft.place("root")
    if between is None or root is None:
        return True
    place = draft.positions[label]
    return median_length(place - between.apply(draft.positions, 1.0)) < 0.35 * median_length(place - root)


def stand_ins(positions: Mapping[str, F64], target: F64, labels: Sequence[str], tolerance: float) -> list[Mix]:
    """Return mixes of three markers each that place a joint in the sampled frames in which it is hidden.

    Parameters
    ----------
    positions : Mapping of str to float64 array (3, K)
        The markers in K sampled frames; NaN where one is not seen.
    target : float64 array (3, K)
        The joint in the same frames; NaN where its own markers are hidden.
    labels : sequence of str
        The markers of its segment.
    tolerance : float
        The largest median error of a stand-in in frames where the joint is visible, in the unit of the places.
    """
    seen = np.isfinite(target).all(axis=0)
    triples = list(combinations(labels[:_MAX_LABELS], 3))
    if seen.all() or not seen.any() or not triples:
        return []
    corners = np.stack([np.stack([positions[label] for label in triple]) for triple in triples])  # (n, 3, 3, K)
    origin, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        normal = np.cross(first, second, axis=1)
        lengths = [np.sqrt((vector * vector).sum(axis=1, keepdims=True)) for vector in (first, second, normal)]
        normal = normal / lengths[2] * lengths[0]
        flat = ~(lengths[2] > _FLAT * lengths[0] * lengths[1])[:, 0]
    basis = np.stack([first, second, normal], axis=-1).transpose(0, 2, 1, 3)  # (n, K, 3, 3)
    known = np.isfinite(basis).all(axis=(2, 3)) & ~flat
    basis[~known] = np.eye(3)
    whole = known & seen
    found = np.linalg.solve(basis, np.where(whole[..., None], (target - origin).transpose(0, 2, 1), 0.0)[..., None])[
        ..., 0
    ]
    hidden, mixes = ~seen, list[Mix]()
    weights = [np.median(found[i][whole[i]], axis=0) if whole[i].any() else None for i in range(len(triples))]
    order = sorted(range(len(triples)), key=lambda i: -int((known[i] & hidden).sum()))
    for i in order:
        shares = weights[i]
        if shares is None or not (known[i] & hidden).any() or len(mixes) == _MAX_STAND_INS:
            continue
        if max(abs(shares[0]), abs(shares[1]), abs(1 - shares[0] - shares[1]), abs(shares[2])) > _FARTHEST:
            continue
        place = origin[i] + np.einsum("kab,b->ak", basis[i], shares)
        if np.median(np.linalg.norm(place - target, axis=0)[whole[i]]) > tolerance:
            continue
        a, b, c = triples[i]
        mixes.append(
            Mix(
                (
                    (a, round(float(1 - shares[0] - shares[1]), 6)),
                    (b, round(float(shares[0]), 6)),
                    (c, round(float(shares[1]), 6)),
                ),
                plane=(a, b, c),
                out=round(float(shares[2]), 6),
            )
        )
        hidden = hidden & ~known[i]
    return mixes
