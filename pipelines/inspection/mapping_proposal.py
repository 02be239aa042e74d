"""Propose a skeleton mapping for a motion file, from recognition or the nearest mapping, for a person to edit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from kinedex.catalog.configs import read_text, scalar
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import MappingRequest, Mappings, load_mappings
from kinedex.catalog.skeletons.named_nodes import named_fit
from kinedex.catalog.skeletons.recognition.proposal import mapping_yaml
from kinedex.catalog.skeletons.skeleton_fit import Fit, Mix
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.motion.file_nodes import FileNodes, read_file_nodes
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, ReadSettings


def propose_mapping(
    file: Path,
    name: str,
    person: str = "",
    source: Path | None = None,
    given: ReadSettings = DEFAULT_SETTINGS,
    named: Mapping[str, str] | None = None,
    only: str | None = None,
) -> str:
    """Return a mapping for a motion file as YAML, even if the file is rejected.

    Parameters
    ----------
    file : Path
        The motion file.
    name : str
        The name of the mapping.
    person : str, optional
        The person, in a file with several.
    source : Path, optional
        The source root, up to which the ASF of an AMC file is searched.
    given : ReadSettings, optional
        The rate, gaps and body model given by the user.
    named : mapping of str to str, optional
        Node → joint or landmark that a person has named, as for `named_fit`.
    only : str, optional
        The regular expression by which the mapping is limited to some files.

    Raises
    ------
    KinedexError
        The file is damaged, is not a motion file, or has no named nodes; or a node cannot be named so.
    """
    mappings = load_mappings("auto", load_feature_set().joints)
    nodes = read_file_nodes(file, mappings, person, source, given)
    return proposed_text(nodes, mappings, file, name, person, named, only)


def proposed_text(
    nodes: FileNodes,
    mappings: Mappings,
    file: Path,
    name: str,
    person: str,
    named: Mapping[str, str] | None,
    only: str | None,
) -> str:
    """Return a mapping for the nodes of a motion file as YAML; parameters as for `propose_mapping`."""
    if named:
        text = mapping_yaml(_of_nodes(named_fit(nodes.asked, mappings, named), nodes.asked.nodes), name)
    else:
        text = _proposal(nodes.asked, mappings, name)
    return _comment(file, person, nodes.fault) + (text if only is None else _limited(text, only))


def _limited(text: str, only: str) -> str:
    """Return the text of a mapping for files in whose names a regular expression is found."""
    try:
        re.compile(only)
    except re.error as fault:
        raise KinedexError(f"--only {only}: is no regular expression: {fault}") from None
    lines = [line for line in text.splitlines() if not line.startswith("only:")]
    begin = next((i for i, line in enumerate(lines, 1) if line.startswith("name:")), 0)
    return "\n".join([*lines[:begin], f"only: {scalar(only)}", *lines[begin:], ""])


def _proposal(asked: MappingRequest, mappings: Mappings, name: str) -> str:
    """Return the mapping that matches, the one that recognition proposes, or the nearest one with its missing nodes."""
    if asked.form is None:
        return ""
    if asked.fit is not None and not asked.fit.reasons:
        return _renamed(asked.fit, name)
    if asked.evidence is None:
        near = mappings.nearest(asked.form, asked.nodes)
        return "" if near is None else _lacking(near, asked) + _renamed(near, name)
    return mapping_yaml(_of_nodes(asked.fit or named_fit(asked, mappings, {}), asked.nodes), name)


def _of_nodes(fit: Fit, nodes: Mapping[str, int]) -> Fit:
    """Return a fit without bone ends that mappings ignore because they coincide with their joints."""

    def seen(name: str) -> str:
        joint = name.removesuffix("_end")
        return joint if name not in nodes and joint in nodes else name

    def of_seen(mix: Mix | None) -> Mix | None:
        if mix is None or mix.of_joints:
            return mix
        weights: dict[str, float] = {}
        for name, weight in mix.weights:
            weights[seen(name)] = weights.get(seen(name), 0.0) + weight
        return replace(mix, weights=tuple(weights.items()))

    choices = {joint: tuple(map(of_seen, mixes)) for joint, mixes in fit.mapping.joints.items()}
    joints = {joint: of_seen(mix) for joint, mix in fit.joints.items()}
    positions = {name: index for name, index in fit.indices.items() if name in nodes}
    return replace(fit, mapping=replace(fit.mapping, joints=choices), joints=joints, indices=positions)


def _comment(file: Path, person: str, fault: SourceError | None) -> str:
    """Return the comment lines above a mapping."""
    whose = f", person {person}" if person else ""
    lines = [f"# A skeleton mapping for files like {file.name}{whose}.".replace("\n", " ")]
    if fault is not None:
        lines.append(f"# Without it, the file is refused: {' '.join(fault.reason.split())}")
    lines.append("# Check it: kinedex inspect FILE --skeleton THIS.yaml; use it: kinedex mapping add STORE THIS.yaml")
    return "\n".join(lines) + "\n\n"


def _renamed(fit: Fit, name: str) -> str:
    """Return the text of a skeleton's mapping file with another `name`."""
    text = read_text(fit.mapping.path)
    lines = [f"name: {scalar(name)}" if line.startswith("name:") else line for line in text.splitlines()]
    return f"# A copy of the mapping '{fit.mapping.name}'.\n" + "\n".join(lines) + "\n"


def _lacking(near: Fit, asked: MappingRequest) -> str:
    """Return comments on the nodes of the nearest mapping that a file lacks, and on the nodes that the file has."""
    lines = [f"# The file has no '{node}', for {what}." for what, node in near.missing.items()]
    return "\n".join([*lines, f"# Its nodes: {', '.join(asked.nodes)}"]) + "\n"
