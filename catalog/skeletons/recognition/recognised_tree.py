"""Recognition of the body in a skeleton tree that no mapping fits by its names."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.recognition.anatomy import (
    ARM_TO_LEG,
    TRUNK_TO_LEG,
    Anatomy,
    Sides,
    find_anatomies,
    find_sides,
    trunk_length,
)
from kinedex.catalog.skeletons.recognition.limbs import Limb
from kinedex.catalog.skeletons.recognition.named_joints import JointMixes, joint_mixes, leg_length
from kinedex.catalog.skeletons.recognition.names import Vocabulary, load_vocabulary
from kinedex.catalog.skeletons.recognition.node_places import twist_nodes
from kinedex.catalog.skeletons.recognition.tree import Tree, build_tree
from kinedex.catalog.skeletons.skeleton_fit import Fit, Format, Mix, SkeletonMapping, axes_of_up
from kinedex.ops.arrays import F64
from kinedex.ops.body.up_axis import UpAxis, up_axis
from kinedex.ops.errors import SourceError

MIN_CONFIDENCE = 0.35
"""Minimum confidence at which a recognised body is accepted."""

NAME = "recognised"
"""The name of a mapping that recognition makes."""

_NO_UP = 0.6  # factor on the confidence if no axis is clearly up
_AT_ZERO = 0.03  # share of the body's height
_UNNAMED = 0.6  # the confidence of a body with perfect proportions and no known names
_LEAD = 1.0  # least lead in score of a body without names over the next one
_FULL_NAMES = 0.9  # the share of named parts above which unusual lengths do not reject the body
_WHOLE_NAMES = 0.6  # the share of named parts above which names alone decide between bodies


def recognise_tree(
    source: str | Path,
    evidence: Evidence,
    joints: Sequence[str],
    form: Format = "bvh",
    vocabulary: Vocabulary | None = None,
) -> Fit:
    """Recognise the body in a skeleton tree by its names, structure and geometry.

    Parameters
    ----------
    source : path
        The file that errors name.
    evidence : Evidence
        Nodes with `parents`, and their places in some frames.
    joints : sequence of str
        The named joints wanted; a joint that the body lacks is unknown.
    form : str, optional
        The format of the mapping that is made.
    vocabulary : Vocabulary, optional
        The names of parts, `configs/names/joints.yaml` by default.

    Returns
    -------
    Fit
        A mapping made for this file, with `confidence`, `reasons` and `estimated`.

    Raises
    ------
    SourceError
        If there is no human body (`not human`), only a part of one that cannot be used (`incomplete`), or several that
        fit equally well (`ambiguous`).
    """
    fit, fault = _recognised(evidence, joints, form, vocabulary or load_vocabulary("joints"), Path(source))
    if fault:
        raise SourceError(
            source,
            f"no skeleton mapping fits its names, and no body is recognised: {fault}; `kinedex mapping new FILE -o "
            "my.yaml` writes a mapping with what was found, to be edited and given by `skeletons`",
        )
    return fit


def propose_tree(
    evidence: Evidence, joints: Sequence[str], form: Format = "bvh", vocabulary: Vocabulary | None = None
) -> Fit:
    """Return the best fit to a skeleton tree, however bad it is: a proposal for a person to edit.

    Parameters
    ----------
    evidence, joints, form, vocabulary
        As for `recognise_tree`.
    """
    return _recognised(evidence, joints, form, vocabulary or load_vocabulary("joints"), Path())[0]


def _recognised(
    evidence: Evidence, joints: Sequence[str], form: Format, vocabulary: Vocabulary, source: Path
) -> tuple[Fit, str]:
    """Return the best fit, and the reason why it cannot be used; the reason is empty if it can be used."""
    positions = {name: i for i, name in enumerate(evidence.names)}
    whole = build_tree(evidence, vocabulary)
    twists = twist_nodes(evidence.names, evidence.parents or ())
    tree = build_tree(evidence.without(twists), vocabulary) if twists else whole
    bodies = find_anatomies(tree)
    if not bodies:
        return _fit(JointMixes(), evidence, joints, form, source, positions, False), _missing_parts(tree)
    body = bodies[0]
    sides = find_sides(tree, body)
    found = joint_mixes(tree, body, sides)
    fit = _fit(found, evidence, joints, form, source, positions, sides.mirrored)
    fit, up_reason, up_sure = _upright(fit, whole, evidence)
    fit = replace(fit, mapping=replace(fit.mapping, root_axes=_root_axes(tree, body, sides, fit.mapping.axes)))
    confidence = _confidence(tree, body, sides) * (1.0 if up_sure else _NO_UP)
    fault = _fault(tree, bodies, confidence, frozenset(vocabulary.terms.get("animal", ())))
    reasons = (*_reasons(tree, body, sides), up_reason)
    fit = replace(fit, doubts=_nameless_end(tree, body))
    fit = replace(fit, estimated=found.estimated, reasons=reasons, confidence=round(confidence, 3))
    digest = hashlib.sha256(repr((fit.mapping.joints, fit.mapping.axes.tolist())).encode()).hexdigest()[:16]
    return replace(fit, mapping=replace(fit.mapping, digest=digest)), fault


def _fit(
    found: JointMixes,
    evidence: Evidence,
    joints: Sequence[str],
    form: Format,
    source: Path,
    positions: Mapping[str, int],
    mirrored: bool,
) -> Fit:
    """Return the mapping of some joints, laid over the nodes; the other joints are unknown."""
    mixes: dict[str, tuple[Mix | None, ...]] = {joint: (found.mixes.get(joint),) for joint in joints}
    axes = axes_of_up(evidence.up or "y", mirrored)
    mapping = SkeletonMapping(
        name=NAME,
        path=source,
        digest="",
        format=form,
        unit_m=evidence.unit_m,
        axes=axes,
        root_axes=axes,
        strip_prefix=None,
        bones={},
        joints=mixes,
    )
    return replace(mapping.fit(positions), reasons=("no body is recognised",), confidence=0.0)


def _upright(fit: Fit, tree: Tree, evidence: Evidence) -> tuple[Fit, str, bool]:
    """Return the fit with its vertical axis set, a sentence about this axis, and whether the axis is certain."""
    if evidence.up is not None:
        return fit, f"{evidence.up} is up, as the file states", True
    judged = judged_up(*joint_positions(fit, tree.positions, tree.rest))
    if not judged.axis:
        return fit, "no axis is clearly up (" + "; ".join(judged.reasons) + "): y is taken", False
    mirrored = np.linalg.det(fit.mapping.axes) < 0
    axes = axes_of_up(judged.axis, bool(mirrored))
    mapping = replace(fit.mapping, axes=axes, root_axes=axes)
    return replace(fit, mapping=mapping), f"{judged.axis} is up: " + "; ".join(judged.reasons), True


def _nameless_end(tree: Tree, body: Anatomy) -> tuple[str, ...]:
    """Return a warning on a head that ends in a node without a known name, which may be the head or its end."""
    last = body.head[-1] if body.head else -1
    if last < 0 or tree.parts[last] or tree.names[last].end or tree.children[last]:
        return ()
    return (f"'{tree.names[last].text}' beyond the neck has no known name: it may be the head, or the end of the head",)


def _root_axes(tree: Tree, body: Anatomy, sides: Sides, axes: F64) -> F64:
    """Return the root's axes at rest, each rounded to the nearest axis of the file; `axes` if they are not clear."""
    limbs = sides.legs or sides.arms
    if limbs is None or not (body.trunk[1:] or body.head):
        return axes
    across = tree.rest[limbs[0].nodes[0]] - tree.rest[limbs[1].nodes[0]]
    ways = [tree.rest[node] - tree.rest[body.hips] for node in (*body.trunk[1:], *body.head)]
    up = next((way for way in ways if np.linalg.norm(way) > 0.02 * leg_length(body)), np.zeros(3))
    found = np.zeros((3, 3))
    for row, vector in ((0, across), (1, up)):
        index = int(np.argmax(np.abs(vector)))
        if abs(vector[index]) <= 0.8 * float(np.linalg.norm(vector)) or not vector[index]:
            return axes
        found[row, index] = np.sign(vector[index])
    hand = np.sign(np.linalg.det(axes))
    found[2] = hand * np.cross(found[0], found[1])
    return found if abs(np.linalg.det(found)) > 0.5 else axes


def judged_up(positions: Mapping[str, F64], rest: Mapping[str, F64] | None) -> UpAxis:
    """Return which axis is up.

    If motion and rest pose disagree, the motion decides if the rest pose is upside down, or if the lowest point of the
    motion is at 0 along its vertical axis.

    Parameters
    ----------
    positions, rest
        As for `kinedex.ops.body.up_axis.up_axis`.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # Absurd numbers are refused later.
        judged = up_axis(positions, rest)
        if judged.axis or rest is None:
            return judged
        alone = up_axis(positions)
        standing = up_axis({joint: np.reshape(place, (3, 1)) for joint, place in rest.items()})
    if not alone.axis:
        return judged
    upside_down = standing.axis and standing.axis[-1] == alone.axis[-1]
    index, sign = "xyz".index(alone.axis[-1]), -1.0 if alone.axis[0] == "-" else 1.0
    heights = sign * np.stack(list(positions.values()))[:, index]
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    if abs(low) < _AT_ZERO * (high - low):
        return replace(alone, reasons=(*judged.reasons, f"the lowest point is at 0 along {alone.axis}"))
    return replace(alone, reasons=judged.reasons) if upside_down else judged


def joint_positions(fit: Fit, positions: F64, rest: F64 | None) -> tuple[dict[str, F64], dict[str, F64] | None]:
    """Return the known joints in sampled frames, (3, K) each, and in the rest pose, (3,) each, in the file's axes.

    Parameters
    ----------
    fit : Fit
        The mapping over the nodes.
    positions : float64 array (N, 3, K)
        The nodes in sampled frames.
    rest : float64 array (N, 3), optional
        The nodes in the rest pose.
    """
    axes = np.diag([np.sign(np.linalg.det(fit.mapping.axes)), 1.0, 1.0])  # keeps the side to which `aside` leads
    plain = replace(fit, mapping=replace(fit.mapping, axes=axes))
    known = tuple(joint for joint in fit.joints if joint not in fit.unknown)

    def apply(nodes: F64) -> dict[str, F64]:
        placed = np.einsum("ab,jbt->jat", axes, plain.apply(nodes, known)) if known else np.empty((0, 3, 1))
        return dict(zip(known, placed, strict=True))

    resting = None if rest is None else {joint: place[:, 0] for joint, place in apply(rest[:, :, None]).items()}
    return apply(positions), resting


def _confidence(tree: Tree, body: Anatomy, sides: Sides) -> float:
    """Return the confidence, from 0 to 1, that this is a human body with these joints."""
    pairs = [pair for pair in (body.legs, body.arms) if pair is not None]
    shape = sum(pair.shape for pair in pairs) / len(pairs) + _proportions(tree, body)
    names = max(body.names, 0.0)
    surely = math.exp(shape / 8.0) * (_UNNAMED + (1.0 - _UNNAMED) * names)
    if sides.mirrored or sides.crossed:
        surely *= 0.6
    elif not sides.named:
        surely *= min(0.4 + abs(sides.facing), 1.0)
    if body.legs is None or body.arms is None:
        surely *= 0.8
    return min(surely, 0.99)


def _proportions(tree: Tree, body: Anatomy) -> float:
    """Return how well arms and trunk fit the legs; 0 is perfect, and less is worse."""
    if body.legs is None or body.arms is None:
        return 0.0
    arms = math.log(body.arms.length / body.legs.length / ARM_TO_LEG) / 0.3
    trunk = math.log(max(trunk_length(tree, body.legs, body.arms) / body.legs.length, 1e-3) / TRUNK_TO_LEG) / 0.4
    return -(arms**2 + trunk**2) / 2


def _fault(tree: Tree, bodies: Sequence[Anatomy], confidence: float, animal: frozenset[str]) -> str:
    """Return the reason why the best body cannot be used; empty if it can be used."""
    body = bodies[0]
    if _on_four_legs(tree, body):
        return "not human (its trunk lies between four legs)"
    tails = [i for i, name in enumerate(tree.names) if animal & {*name.words, name.key} and not name.end]
    if tails and (body.legs is None or body.arms is None or _proportions(tree, body) < -1.0):
        return f"not human (it has '{tree.names[tails[0]].text}', and not a human's arms, legs and trunk)"
    if body.names < _WHOLE_NAMES and len(bodies) > 1 and body.score - bodies[1].score < _LEAD:
        one, other = (_in_words(tree, pair) for pair in bodies[:2])
        return f"ambiguous (the limbs may be {one}, or {other})"
    if confidence < MIN_CONFIDENCE and body.names < _FULL_NAMES:
        kind = "ambiguous" if body.names > _WHOLE_NAMES else "not human"
        return f"{kind} (the nearest body, {_in_words(tree, body)}, has a confidence of {confidence:.2f})"
    return ""


def _on_four_legs(tree: Tree, body: Anatomy) -> bool:
    """Return whether the arms are a second pair of legs, equally long and parallel, at the end of a level trunk."""
    if body.legs is None or body.arms is None or body.arms.length < 0.85 * body.legs.length:
        return False
    hips, ankles = _middle(tree, body, 0)
    shoulders, wrists = _middle(tree, body, 1)
    legs, arms, trunk = ankles - hips, wrists - shoulders, shoulders - hips
    level = np.abs(_cosine(legs, trunk)) < 0.6
    return bool(np.mean(level & (_cosine(legs, arms) > 0.7)) > 0.7)


def _middle(tree: Tree, body: Anatomy, which: int) -> tuple[F64, F64]:
    """Return the midpoints of the hips and the ankles (0), or of the shoulders and the wrists (1), (3, K) each."""
    pair = (body.legs, body.arms)[which]
    assert pair is not None
    near, far = ((tree.positions[pair.first.nodes[i]] + tree.positions[pair.second.nodes[i]]) / 2 for i in (0, 2))
    return near, far


def _cosine(a: F64, b: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=0) / (np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)))


def _missing_parts(tree: Tree) -> str:
    """Return the reason why no body is found at all."""
    named = {part for parts in tree.parts for part in parts}
    limbs = named & {"thigh", "calf", "foot", "upperarm", "forearm", "hand"}
    if len(limbs) >= 3:
        return "incomplete (there are limbs, but no two legs or two arms alike)"
    return "not human (no two legs and no two arms in its tree)"


def _in_words(tree: Tree, body: Anatomy) -> str:
    pairs = [pair for pair in (body.legs, body.arms) if pair is not None]
    return " with ".join(f"{_limb(tree, pair.first)} and {_limb(tree, pair.second)}" for pair in pairs)


def _limb(tree: Tree, limb: Limb) -> str:
    return "–".join(tree.names[node].text for node in limb.nodes)


def _reasons(tree: Tree, body: Anatomy, sides: Sides) -> tuple[str, ...]:
    """Return sentences about the recognised legs, arms and trunk, and the evidence for them."""
    found = []
    for called, limbs in (("legs", sides.legs), ("arms", sides.arms)):
        if limbs is not None:
            found.append(f"{called}: left {_limb(tree, limbs[0])}, right {_limb(tree, limbs[1])}")
        else:
            found.append(f"no {called}")
    if body.trunk:
        trunk = "–".join(tree.names[node].text for node in (*body.trunk, *body.head))
        found.append(f"trunk and head: {trunk}")
    found.append(f"names state {100 * max(body.names, 0):.0f} % of the parts of the limbs")
    if body.legs is not None and body.arms is not None:
        arms = body.arms.length / body.legs.length
        trunk_share = trunk_length(tree, body.legs, body.arms) / body.legs.length
        found.append(
            f"arms are {arms:.2f} and the trunk is {trunk_share:.2f} of the legs (a human's: {ARM_TO_LEG} and "
            f"{TRUNK_TO_LEG})"
        )
    found.append(_sides_in_words(sides))
    return tuple(found)


def _sides_in_words(sides: Sides) -> str:
    if sides.crossed:
        return "the left leg and the left arm, by their names, lie on different sides"
    if sides.mirrored:
        return (
            f"what names call left lies on the right by feet and knees ({sides.facing:+.2f}): the file's axes are "
            "taken for left-handed"
        )
    seen = f"{sides.facing:+.2f} of 1"
    if sides.named:
        agree = "agree" if sides.facing > 0.5 else "show nothing clear"
        return f"left and right by names; feet and knees {agree} ({seen})"
    return f"left and right by feet and knees ({seen}); names state no side"
