"""Nodes of a file that a person has named, and what recognition takes each node for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from kinedex.catalog.skeletons.mappings import MappingRequest, Mappings
from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, load_landmarks
from kinedex.catalog.skeletons.recognition.named_points import (
    NOTHING,
    check_names,
    named_reading,
    nodes_of_landmarks,
    skin_landmarks,
)
from kinedex.catalog.skeletons.recognition.points import propose_points
from kinedex.catalog.skeletons.recognition.recognised_tree import propose_tree
from kinedex.catalog.skeletons.skeleton_fit import Fit, Mix
from kinedex.ops.errors import KinedexError


@dataclass(frozen=True)
class NodeGuess:
    """A guess of the joint or landmark that a node of a file is.

    Attributes
    ----------
    node : str
        The node, as the file calls it.
    name : str
        The joint or landmark that it is; empty if it is neither.
    reason : str
        The reason, as a phrase.
    joints : tuple of str
        The joints that are made of it.
    """

    node: str
    name: str
    reason: str
    joints: tuple[str, ...]


def is_tree(asked: MappingRequest) -> bool:
    """Return whether the nodes of a body form a tree, so that they are joints and no markers."""
    return asked.evidence is not None and asked.evidence.parents is not None


def node_names(asked: MappingRequest, mappings: Mappings) -> tuple[str, ...]:
    """Return the names that a node can be given: the named joints and, for points, the landmarks on the skin."""
    if is_tree(asked):
        return mappings.joints
    # of a joint and a landmark of the same name, such as lwrist, the name stands for the joint
    return tuple(dict.fromkeys((*mappings.joints, *skin_landmarks(mappings.landmarks or load_landmarks()))))


def named_fit(asked: MappingRequest, mappings: Mappings, named: Mapping[str, str]) -> Fit:
    """Return the fit that recognition makes where a person has named some nodes.

    Parameters
    ----------
    asked : MappingRequest
        The body for which a reader requested a mapping.
    mappings : Mappings
        The mappings of the archive, for their joints and vocabularies.
    named : mapping of str to str
        Node → joint or landmark, or `NOTHING` for a node that is neither; other nodes keep what recognition takes them
        for.

    Raises
    ------
    KinedexError
        The file has no node of a name, a name is unknown, or two nodes have the same one.
    """
    if asked.evidence is None or asked.form is None:
        raise KinedexError(
            "the nodes of this file cannot be named one by one, since a mapping fits all of them; `kinedex mapping new "
            "FILE -o my.yaml` writes a copy of it, to be edited"
        )
    joints, landmarks = mappings.joints, mappings.landmarks or load_landmarks()
    known = (*joints, *(() if is_tree(asked) else landmarks.order))
    check_names(named, asked.evidence.names, known, tuple(landmarks.many))
    if not is_tree(asked):
        return propose_points(asked.evidence, joints, asked.form, landmarks, named)
    return _named_tree(propose_tree(asked.evidence, joints, asked.form, mappings.vocabulary), named)


def _named_tree(fit: Fit, named: Mapping[str, str]) -> Fit:
    """Return the fit of a tree in which some nodes are the joints that a person has named."""
    chosen = {joint: node for node, joint in named.items() if joint != NOTHING}
    choices: dict[str, tuple[Mix | None, ...]] = {}
    for joint, mixes in fit.mapping.joints.items():
        mix = next(iter(mixes), None)
        lost = mix is not None and not mix.of_joints and any(node in named for node in mix.names)
        choices[joint] = (None,) if lost else mixes
    choices |= {joint: (Mix(((node, 1.0),)),) for joint, node in chosen.items()}
    while broken := [joint for joint, mixes in choices.items() if _lacks(mixes[0], choices)]:
        choices |= dict.fromkeys(broken, (None,))
    made = replace(fit.mapping, joints=choices).fit(fit.indices)
    estimated = {joint: how for joint, how in fit.estimated.items() if choices[joint][0] and joint not in chosen}
    return replace(made, estimated=estimated, reasons=fit.reasons, confidence=fit.confidence)


def _lacks(mix: Mix | None, choices: Mapping[str, tuple[Mix | None, ...]]) -> bool:
    """Return whether a joint is made of joints that are unknown."""
    return mix is not None and mix.of_joints and any(choices[name][0] is None for name in mix.names)


def guessed_fit(asked: MappingRequest, mappings: Mappings) -> Fit | None:
    """Return the fit of a file in which nobody has named nodes: that by which it is read, else the best one.

    The result is None if the file is refused and its format has no nodes for recognition.
    """
    if asked.fit is not None or asked.evidence is None:
        return asked.fit
    return named_fit(asked, mappings, {})


def node_guesses(
    asked: MappingRequest, mappings: Mappings, fit: Fit | None, named: Mapping[str, str]
) -> tuple[NodeGuess, ...]:
    """Return what each node of a file is taken for, and why.

    Parameters
    ----------
    asked, mappings, named
        As for `named_fit`.
    fit : Fit or None
        The fit that it returned, or that of `guessed_fit`.
    """
    names = asked.evidence.names if asked.evidence is not None else tuple(asked.nodes)
    made: dict[str, list[str]] = {}
    for joint, mix in fit.joints.items() if fit is not None else ():
        for node in mix.names if mix is not None and not mix.of_joints else ():
            made.setdefault(node, []).append(joint)
    if fit is None or not fit.recognised or is_tree(asked):
        taken = _by_joints(fit)
    else:
        taken = _by_labels(names, mappings.landmarks or load_landmarks(), named)
    return tuple(_guess(node, named, taken, made) for node in names)


def _guess(
    node: str, named: Mapping[str, str], taken: Mapping[str, tuple[str, str]], made: Mapping[str, Sequence[str]]
) -> NodeGuess:
    """Return the guess of one node, by its name if a person has given one."""
    name, reason = taken.get(node, ("", "a joint lies between it and others" if node in made else "no known name"))
    if node in named:
        name, reason = "" if named[node] == NOTHING else named[node], "named by you"
    return NodeGuess(node, name, reason, tuple(made.get(node, ())))


def _by_labels(names: Sequence[str], landmarks: Landmarks, named: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the landmark of each label, and the reason."""
    read = landmarks.read(names)
    reading = named_reading(read, landmarks, named) if named else read
    kind = "markers on the skin" if reading.skin else "joint centres"
    found = {
        label: (name, f"its label is one for {name}, among {kind}")
        for label, name in nodes_of_landmarks(reading).items()
    }
    lost = {label: ("", "another node is named so") for label in nodes_of_landmarks(read) if label not in found}
    return lost | found


def _by_joints(fit: Fit | None) -> dict[str, tuple[str, str]]:
    """Return for each node its joint, by a mapping or by a recognised tree, and the reason."""
    if fit is None:
        return {}
    whole = {mix.node: joint for joint, mix in fit.joints.items() if mix is not None and mix.node is not None}
    tree = "by its name and its place in the tree"
    reason = tree if fit.recognised else f"by the mapping '{fit.mapping.name}'"
    return {node: (joint, reason) for node, joint in whole.items() if node is not None}
