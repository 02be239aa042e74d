"""Group markers by the rigid segment of the body that they move with."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks

_PELVIS = ("lasis", "rasis", "lpsis", "rpsis", "sacrum", "lcrest", "rcrest", "ltrochanter", "rtrochanter")
_THORAX = ("c7", "t10", "clav", "strn", "lsternoclavicular", "rsternoclavicular", "lacromion", "racromion")
_HEAD = (
    "lheadfront", "rheadfront", "lheadback", "rheadback", "lheadside", "rheadside", "headtop", "headmid", "headrear",
)  # fmt: skip
_SIDED = {
    "thigh": ("trochanter", "thigh", "kneelat", "kneemed"),
    "shank": ("kneelat", "kneemed", "shank", "anklelat", "anklemed"),
    "foot": ("anklelat", "anklemed", "heel", "toe1", "toe2", "toe5", "toetip", "midfoot"),
    "upper arm": ("acromion", "elbowlat", "elbowmed"),
    "forearm": ("elbowlat", "elbowmed", "wristrad", "wristuln", "wrist"),
    "hand": ("wristrad", "wristuln", "wrist", "hand", "hand2", "hand5"),
}

SEGMENTS: dict[str, tuple[str, ...]] = {
    "pelvis": _PELVIS,
    "thorax": _THORAX,
    "head": _HEAD,
    **{
        f"{side} {name}": tuple(f"{side[0]}{landmark}" for landmark in landmarks)
        for name, landmarks in _SIDED.items()
        for side in ("left", "right")
    },
}
"""The landmarks of each segment; those at a joint move with both of its segments."""


_TRUNK = tuple(landmark for landmark in _THORAX if not landmark.endswith("acromion"))

RIGID_SEGMENTS: dict[str, tuple[str, ...]] = {
    **SEGMENTS,
    "thorax": _TRUNK,
    **{f"{side} shoulder": (*_TRUNK, f"{side[0]}acromion") for side in ("left", "right")},
    **{f"{side} upper arm": (f"{side[0]}elbowlat", f"{side[0]}elbowmed") for side in ("left", "right")},
}
"""The same where nothing shows whether a marker keeps its place: shoulders move against each other and against arms."""


def marker_segments(labels: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of the labels of each segment that has four markers or more, by its name.

    Four are the least of which one can be placed by three others.
    """
    named = load_landmarks().read(labels).labels
    index = {label: i for i, label in enumerate(labels)}
    found = {
        segment: [index[label] for landmark in landmarks for label in named.get(landmark, ())]
        for segment, landmarks in SEGMENTS.items()
    }
    return {segment: places for segment, places in found.items() if len(places) > 3}
