"""Find labels of a body's points that seem to be exchanged, by comparing left with right and front with back.

A body with two labels exchanged is still a body, so that proportions alone do not show it. Points of one side are
compared with those of the other, and points in the middle with both. The facing direction that follows from left and
right is compared with that of toes, pelvis, thorax and face.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kinedex.catalog.skeletons.recognition.landmarks import Reading, model_labels
from kinedex.catalog.skeletons.recognition.point_trunk import SIDES, BodyDraft, median_of
from kinedex.ops.arrays import F64

_CHAIN = {
    "toe1": ("heel", "anklelat"), "toe2": ("heel", "anklelat"), "toe5": ("heel", "anklelat"),
    "heel": ("anklelat", "anklejoint"), "anklelat": ("kneelat", "kneemed"), "anklemed": ("kneemed", "kneelat"),
    "kneelat": ("hip",), "kneemed": ("hip",), "psis": ("asis",), "trochanter": ("asis", "psis"),
    "elbowlat": ("acromion",), "elbowmed": ("acromion",), "wristrad": ("elbowlat", "elbowmed"),
    "wristuln": ("elbowmed", "elbowlat"), "wrist": ("elbowlat",), "hand": ("wristuln", "wristrad", "wrist"),
    "hand2": ("wristrad",), "hand5": ("wristuln",), "headfront": ("headback",),
    "kneejoint": ("hipjoint",), "anklejoint": ("kneejoint",), "bigtoe": ("heel", "anklejoint"),
    "smalltoe": ("heel", "anklejoint"), "elbowjoint": ("shoulderjoint",), "wristjoint": ("elbowjoint",),
    "shoulderjoint": ("hipjoint",), "acromion": ("hip",),
}  # fmt: skip
"""Landmarks of a side, each with those nearer to the trunk from which its distance hardly changes."""

_BENDING = ("acromion", "shoulderjoint")  # at the end of a trunk that bends, so that only crossing is looked for
_FEET = ("toe1", "toe2", "toe5", "bigtoe", "smalltoe")

_RIGID = (
    ("lasis", "rasis"), ("lasis", "lpsis"), ("lasis", "rpsis"), ("rasis", "rpsis"), ("lheadfront", "rheadback"),
    ("lheadback", "rheadfront"), ("lheadfront", "rheadfront"), ("lheel", "ltoe2"), ("rheel", "rtoe2"),
    ("lheel", "lanklelat"), ("rheel", "ranklelat"), ("clav", "strn"), ("c7", "t10"),
)  # fmt: skip
"""Pairs of landmarks whose distance stays the same, as they lie on one bone or nearly so."""

_MIDDLE = {
    "c7": ("acromion",), "clav": ("acromion",), "strn": ("acromion",), "t10": ("acromion",), "sacrum": ("psis", "asis"),
    "neckjoint": ("shoulderjoint",), "pelvis": ("hipjoint",), "nose": ("ear", "eye"),
}  # fmt: skip
"""Landmarks in the middle, each with landmarks of both sides from which it is equally far."""

_LEVELS = (
    ("strn", "clav"), ("t10", "c7"), ("sacrum", "t10"), ("c7", "lheadback"), ("c7", "rheadback"),
    ("clav", "lheadfront"), ("clav", "rheadfront"), ("pelvis", "neckjoint"), ("ltrochanter", "lasis"),
    ("rtrochanter", "rasis"), ("lscapula", "lacromion"), ("rscapula", "racromion"), ("lscapula", "c7"),
    ("rscapula", "c7"),
)  # fmt: skip
"""Pairs of landmarks of the trunk, the lower one first."""

_FARTHER = (
    ("kneelat", "anklelat", "heel", 1.0), ("kneejoint", "anklejoint", "heel", 1.0),
    *(("elbowlat", "wristrad", hand, 1.0) for hand in ("hand", "hand2")),
    *(("elbowlat", "wristuln", hand, 1.0) for hand in ("hand", "hand5")),
    ("heel", "anklelat", "toe2", 1.0), ("heel", "anklelat", "toe5", 1.0), ("heel", "anklejoint", "bigtoe", 1.0),
    *(("kneelat", "heel", toe, 0.75) for toe in ("toe1", "toe2", "toe5")), ("kneejoint", "heel", "bigtoe", 0.75),
)  # fmt: skip
"""Landmarks of a side: the third is farther from the first than this share of the second's distance from it is, however
the limb is bent."""

_SIDED = (("acromion", ("c7", "clav", "t10", "strn")), ("shoulderjoint", ("neckjoint", "thorax")))
"""Landmarks of a side that lie on this side of others, in the middle, as the hips define it."""

_UNEVEN = 0.07  # of a leg, some 6 cm; right files differ by up to 5 cm, as markers are not set alike
_UNEVEN_HANDS = 0.08  # of a leg, as the markers of hands are set where there is room
_UNEVEN_FOOT = (0.25, 0.045)  # of the distance, at least so much of a leg
_MOVING = (0.1, 0.02)  # half the interquartile range, as a share of the distance, at least so much of a leg
_OFF_MIDDLE = 0.07  # of a leg; shoulders move against the spine
_ONE_PLACE = 0.005  # of a leg; markers of different landmarks are some cm apart
_FEW, _MOSTLY = 4, 0.5  # frames in which that is looked for, and the share in which it must be so
_NEIGHBOUR = 0.12  # of a leg; how far away another point may be with which a landmark is exchanged
_MOVING_SHANK = 0.002  # of a leg, some 2 mm, from which an ankle marker moves against the shank
_STEADIER = 2.0  # times less than that an unknown point must move to be the ankle marker rather
_SURE = 0.2  # cosine of an angle from which a direction points ahead or back
_SHOWN = 4  # most findings in a warning


def exchanged_labels(draft: BodyDraft, reading: Reading, leg: float) -> list[str]:
    """Return a warning if labels contradict each other; empty for a body whose sides and front agree.

    Parameters
    ----------
    draft : BodyDraft
        The points in sampled frames, and the joints found.
    reading : Reading
        The landmarks that the labels name.
    leg : float
        Length of a leg in the unit of the points.
    """
    if not leg > 0:
        return []
    places = {name: draft.positions[labels[0]] for name, labels in reading.labels.items() if len(labels) == 1}
    called = {name: labels[0] for name, labels in reading.labels.items()}
    for joint in ("lhip", "rhip"):
        place = draft.place(joint)
        if place is not None:
            places[joint], called[joint] = place, f"the {'left' if joint[0] == 'l' else 'right'} hip"
    found = [
        *_mirrored(draft, places, called),
        *_sides(places, called, leg),
        *_moving(places, called, leg),
        *_farther(places, called),
        *_middles(places, called, leg),
        *_sided(places, called),
        *_levels(draft, places, called),
        *_of_the_shank(draft, reading, leg),
        *(_at_one_place(places, called, leg) if reading.skin else ()),
    ]
    if not found:
        return []
    more = f", and {len(found) - _SHOWN} more such findings" if len(found) > _SHOWN else ""
    return [f"labels may be exchanged, or stand for other points: {'; '.join(found[:_SHOWN])}{more}"]


def _apart(a: F64, b: F64) -> F64:
    return np.asarray(np.sqrt(((a - b) ** 2).sum(axis=0)))


def _usual(values: F64) -> float:
    """Return the median of the finite values; NaN if fewer than a quarter are finite, as these may be odd postures."""
    return median_of(values) if 4 * np.count_nonzero(np.isfinite(values)) >= len(values) else float("nan")


def _times(a: float, b: float) -> str:
    """Return the ratio of two distances in words."""
    return f"{a / b:.2f} times" if b > 0 else "many times"


def _sides(places: Mapping[str, F64], called: Mapping[str, str], leg: float) -> Iterator[str]:
    """Yield a clause for each landmark whose left and right points seem to be exchanged, or are not alike.

    Exchanged points are nearer to each other's neighbours than to their own. Of points that are not alike, one is
    farther from its neighbour than the other is.
    """
    for part, inner in ((part, inner) for part, nearer in _CHAIN.items() for inner in nearer):
        if not {f"{side}{name}" for side in SIDES for name in (part, inner)} <= places.keys():
            continue
        left, right = (places[f"{side}{part}"] for side in SIDES)
        near_left, near_right = (places[f"{side}{inner}"] for side in SIDES)
        own = [_apart(left, near_left), _apart(right, near_right)]
        crossed = _apart(left, near_right) + _apart(right, near_left)
        if median_of(crossed - own[0] - own[1]) < 0:
            yield (
                f"{called[f'l{part}']} and {called[f'r{part}']} are nearer to {called[f'r{inner}']} and "
                f"{called[f'l{inner}']} than to those of their own sides"
            )
            continue
        first, second = map(median_of, own)
        if part not in _BENDING and abs(first - second) > _tolerance(part, (first + second) / 2, leg):
            yield (
                f"{called[f'l{part}']} and {called[f'l{inner}']} are {_times(first, second)} as far apart as "
                f"{called[f'r{part}']} and {called[f'r{inner}']}"
            )


def _tolerance(part: str, distance: float, leg: float) -> float:
    """Return by how much the distances of a landmark from its neighbour may differ between the sides."""
    if part in _FEET:
        share, least = _UNEVEN_FOOT
        return min(max(share * distance, least * leg), _UNEVEN * leg)
    return (_UNEVEN_HANDS if part.startswith("h") else _UNEVEN) * leg


def _moving(places: Mapping[str, F64], called: Mapping[str, str], leg: float) -> Iterator[str]:
    """Yield a clause for each pair of landmarks of one bone whose distance changes."""
    for a, b in _RIGID:
        if a in places and b in places:
            lengths = _apart(places[a], places[b])
            lengths = lengths[np.isfinite(lengths)]
            if len(lengths) > 2:
                low, middle, high = np.percentile(lengths, [25, 50, 75])
                if (high - low) / 2 > max(_MOVING[0] * middle, _MOVING[1] * leg):
                    yield f"{called[a]} and {called[b]}, which lie on one bone, move against each other"


def _farther(places: Mapping[str, F64], called: Mapping[str, str]) -> Iterator[str]:
    """Yield a clause for each entry of `_FARTHER` whose third landmark is too near to the first.

    This is impossible in a real limb: a heel, for example, is farther from the knee than the ankle is.
    """
    for side in SIDES:
        for *parts, share in _FARTHER:
            first, near, far = (f"{side}{part}" for part in parts)
            if {first, near, far} <= places.keys():
                away = _apart(places[first], places[far]) - share * _apart(places[first], places[near])
                if median_of(away) < 0:
                    yield f"{called[far]} is nearer to {called[first]} than {called[near]}"


def _middles(places: Mapping[str, F64], called: Mapping[str, str], leg: float) -> Iterator[str]:
    """Yield a clause for a pelvis with unequal diagonals, and one for each middle landmark nearer to one side."""
    if {"lasis", "rasis", "lpsis", "rpsis"} <= places.keys():
        across = [median_of(_apart(places[f"{a}asis"], places[f"{b}psis"])) for a, b in ("lr", "rl")]
        if abs(across[0] - across[1]) > _UNEVEN * leg:
            yield (
                f"{called['lasis']} and {called['rpsis']} are {_times(*across)} as far apart as "
                f"{called['rasis']} and {called['lpsis']}"
            )
    for part, sides in _MIDDLE.items():
        side = next((one for one in sides if {f"l{one}", f"r{one}"} <= places.keys()), None)
        if side is None or part not in places:
            continue
        to_left, to_right = (_apart(places[part], places[f"{one}{side}"]) for one in SIDES)
        width = _apart(places[f"l{side}"], places[f"r{side}"])
        with np.errstate(invalid="ignore", divide="ignore"):
            off = median_of((to_left**2 - to_right**2) / (2 * width))
        if abs(off) > _OFF_MIDDLE * leg:
            yield (
                f"{called[part]} is {_times(median_of(to_left), median_of(to_right))} as far from "
                f"{called[f'l{side}']} as from {called[f'r{side}']}"
            )


def _sided(places: Mapping[str, F64], called: Mapping[str, str]) -> Iterator[str]:
    """Yield a clause for each landmark of a side that is on the other side of one in the middle."""
    if not {"lhip", "rhip"} <= places.keys():
        return
    across = places["lhip"] - places["rhip"]
    for part, middles in _SIDED:
        for side, sign, word in (("l", 1.0, "right"), ("r", -1.0, "left")):
            for middle in (middle for middle in middles if middle in places and f"{side}{part}" in places):
                away = sign * (places[f"{side}{part}"] - places[middle])
                if _usual((away * across).sum(axis=0)) < 0 and _usual(_cosine(away, across)) < -_SURE:
                    yield f"{called[f'{side}{part}']} is on the {word} of {called[middle]}"


def _at_one_place(places: Mapping[str, F64], called: Mapping[str, str], leg: float) -> Iterator[str]:
    """Yield a clause for each pair of markers of different landmarks that lie at one place."""
    names = [name for name in places if name not in ("lhip", "rhip")]
    if len(names) < 2:
        return
    whole = np.nan_to_num(np.stack([places[name] for name in names]), nan=np.inf)
    some = whole[:, :, :: max(1, whole.shape[2] // _FEW)]
    i, j = np.triu_indices(len(names), 1)
    with np.errstate(invalid="ignore"):
        apart = np.abs(some[i] - some[j]).max(axis=1)  # NaN where both are hidden
    for pair in np.flatnonzero((apart <= _ONE_PLACE * leg).mean(axis=1) >= _MOSTLY):
        yield f"{called[names[i[pair]]]} and {called[names[j[pair]]]} are at the same place"


def _of_the_shank(draft: BodyDraft, reading: Reading, leg: float) -> Iterator[str]:
    """Yield a clause for each ankle marker that moves against the shank while an unknown point near it does not."""
    of_model = model_labels(reading.unread)
    unknown = [label for label in reading.unread if label not in of_model]
    for side in SIDES:
        of = {name: reading.labels.get(f"{side}{name}", ()) for name in ("kneelat", "kneemed", "shank")}
        fixed = [draft.positions[label] for labels in of.values() for label in labels]
        if len(fixed) < 3 or not of["shank"]:
            continue
        for label in (label for part in ("lat", "med") for label in reading.labels.get(f"{side}ankle{part}", ())):
            own = draft.positions[label]
            spread = _spread(own, fixed)
            if not spread > _MOVING_SHANK * leg:
                continue
            for other in unknown:
                place = draft.positions[other]
                near = median_of(_apart(place, own)) < _NEIGHBOUR * leg
                if near and spread > _STEADIER * _spread(place, fixed):
                    yield f"{other} moves less against the shank than {label} beside it does"


def _spread(point: F64, others: Sequence[F64]) -> float:
    """Return half the interquartile range of a point's distance from others, the median over these."""
    found = []
    for other in others:
        away = _apart(point, other)
        low, high = np.percentile(away[np.isfinite(away)], [25, 75]) if np.isfinite(away).any() else (np.nan, np.nan)
        found.append((high - low) / 2)
    return float(np.median(found))


def _levels(draft: BodyDraft, places: Mapping[str, F64], called: Mapping[str, str]) -> Iterator[str]:
    """Yield a clause for each pair of landmarks of the trunk of which the lower one is above the other."""
    root, neck = draft.place("root"), draft.place("neck")
    if root is None or neck is None:
        return
    for lower, upper in _LEVELS:
        if (
            lower in places
            and upper in places
            and _usual(((places[upper] - places[lower]) * (neck - root)).sum(axis=0)) < 0
        ):
            yield f"{called[lower]} is above {called[upper]}"


def _mirrored(draft: BodyDraft, places: Mapping[str, F64], called: Mapping[str, str]) -> Iterator[str]:
    """Yield a clause for each pair of `_fronts` that points backwards, where left, right and up define the front.

    If most pairs point backwards, a single clause says that the sides, or the axes, are mirrored.
    """
    at = {joint: draft.place(joint) for joint in ("lhip", "rhip", "root", "neck")}
    left, right, root, neck = at["lhip"], at["rhip"], at["root"], at["neck"]
    if left is None or right is None or root is None or neck is None:
        return
    ahead = np.cross(left - right, neck - root, axis=0)
    votes = {
        f"{called[back]} and {called[front]}": cosine
        for back, front in _fronts(places)
        if abs(cosine := median_of(_cosine(places[front] - places[back], ahead))) > _SURE
    }
    behind = [pair for pair, cosine in votes.items() if cosine < 0]
    if len(behind) > len(votes) / 2:
        yield f"by left and right the body faces backwards, as {behind[0]} show: its sides, or its axes, are mirrored"
    else:
        yield from (f"{pair} lie the other way round than the body faces" for pair in behind)


def _fronts(places: Mapping[str, F64]) -> Iterator[tuple[str, str]]:
    """Yield pairs of landmarks, of which the second is in front of the first in every posture."""
    for side in SIDES:
        toes = next((one for one in ("toe2", "toe1", "toe5", "toetip", "bigtoe") if f"{side}{one}" in places), None)
        heel = next((one for one in ("heel", "anklelat", "anklejoint") if f"{side}{one}" in places), None)
        if toes and heel:
            yield f"{side}{heel}", f"{side}{toes}"
    pairs = [("lpsis", "lasis"), ("rpsis", "rasis"), ("sacrum", "lasis"), ("c7", "clav"), ("t10", "strn")]
    pairs += [("lear", "nose"), ("headjoint", "nose")]
    yield from ((back, front) for back, front in pairs if {back, front} <= places.keys())


def _cosine(a: F64, b: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=0) / np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0)))
