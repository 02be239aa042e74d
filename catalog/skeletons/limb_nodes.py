"""The nodes of a skeleton that turn with limbs, and the markers that lie on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from kinedex.catalog.limbs import LIMBS, Limb
from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, load_landmarks
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.errors import SourceError, did_you_mean

MIN_MARKERS = 3

_LANDMARKS = {
    "pelvis": ("lasis", "rasis", "lpsis", "rpsis", "sacrum", "lcrest", "rcrest"),
    "torso": ("c7", "t10", "clav", "strn"),
    "head": ("lheadfront", "rheadfront", "lheadback", "rheadback", "lheadside", "rheadside", "headtop", "headmid",
             "headrear"),
    "forearm": ("elbowlat", "wristrad", "wristuln"),
    "hand": ("wristrad", "wristuln", "hand", "hand2", "hand5"),
    "thigh": ("thigh", "kneelat", "kneemed", "trochanter"),
    "shank": ("shank", "kneelat", "kneemed", "anklelat", "anklemed"),
    "foot": ("heel", "toe1", "toe2", "toe5", "midfoot", "anklelat", "anklemed"),
}  # fmt: skip
"""A dict from limb to the landmarks of configs/names/landmarks.yaml that move with it, both without side.

A wrist bends about the line through its two markers, so that these turn with the hand as well as with the forearm. A
shoulder's marker does not move with the upper arm, whose orientation is that of the hinge.
"""


def limb_nodes(source: str | Path, fit: Fit, parents: Sequence[int], at_end: bool) -> dict[str, int]:
    """Return the node that turns with each limb: the one whose bone leads from the near joint towards the far one.

    Parameters
    ----------
    source : str or Path
        The file that errors name.
    fit : Fit
        The mapping over the skeleton.
    parents : sequence of int
        The index of each node's parent, −1 for roots.
    at_end : bool
        True where a node's place is the far end of its bone (Acclaim), False where its bone begins there.

    Returns
    -------
    dict of str to int
        Limb → index of its node, for the limbs that have one.

    Raises
    ------
    SourceError
        The skeleton has no node that the mapping names for a limb.
    """
    found = {}
    for name, limb in LIMBS.items():
        own = fit.mapping.limbs.get(name)
        if own is not None and own.node is not None:
            if own.node not in fit.indices:
                raise SourceError(
                    source,
                    f"the skeleton has no '{own.node}', which mapping '{fit.mapping.name}' ({fit.mapping.path}) takes "
                    f"for limb '{name}'{did_you_mean(own.node, fit.indices)}",
                )
            found[name] = fit.indices[own.node]
            continue
        node = _node_of(limb, fit, parents, at_end)
        if node is not None:
            found[name] = node
    return found


def _node_of(limb: Limb, fit: Fit, parents: Sequence[int], at_end: bool) -> int | None:
    near, far = _single(fit, limb.near), _single(fit, limb.far)
    if limb.name == "pelvis":
        return near
    if near is not None and not at_end:
        return near if far != near else None
    if far is None:
        return None
    above = far
    while above >= 0 and parents[above] != near and near is not None:
        above = parents[above]
    if near is not None:
        return above if above >= 0 else None
    return far if at_end else (parents[far] if parents[far] >= 0 else None)


def _single(fit: Fit, joint: str) -> int | None:
    """Return the index of the node at a joint; None if the joint is unknown or combined from several nodes."""
    mix = fit.joints.get(joint)
    return None if mix is None or mix.node is None else fit.indices[mix.node]


def limb_markers(source: str | Path, fit: Fit, landmarks: Landmarks | None = None) -> dict[str, tuple[int, ...]]:
    """Return the markers of each limb that has at least three.

    A limb has the markers that the mapping names for it or, if it names none, those on landmarks of the limb.

    Parameters
    ----------
    source : str or Path
        The file that errors name.
    fit : Fit
        The mapping over the markers.
    landmarks : Landmarks, optional
        The labels of landmarks; `configs/names/landmarks.yaml` by default.

    Returns
    -------
    dict of str to tuple of int
        Limb → indices of its markers.

    Raises
    ------
    SourceError
        The file has no marker that the mapping names for a limb.
    """
    labels = _labels(fit.indices, landmarks or load_landmarks())
    found = {}
    for name, limb in LIMBS.items():
        own = fit.mapping.limbs.get(name)
        if own is not None and own.markers:
            lacking = [marker for marker in own.markers if marker not in fit.indices]
            if lacking:
                raise SourceError(
                    source,
                    f"has no marker '{lacking[0]}', which mapping '{fit.mapping.name}' ({fit.mapping.path}) puts on "
                    f"limb '{name}'{did_you_mean(lacking[0], fit.indices)}",
                )
            found[name] = tuple(fit.indices[marker] for marker in own.markers)
            continue
        wanted = (limb.side + landmark for landmark in _LANDMARKS.get(name[len(limb.side) :], ()))
        positions = tuple(dict.fromkeys(fit.indices[label] for one in wanted for label in labels.get(one, ())))
        if len(positions) >= MIN_MARKERS:
            found[name] = positions
    return found


def _labels(positions: Mapping[str, int], landmarks: Landmarks) -> dict[str, tuple[str, ...]]:
    """Return the labels of the landmarks of markers on the skin; nothing for a file of joint centres."""
    reading = landmarks.read(list(positions))
    return reading.labels if reading.skin else {}
