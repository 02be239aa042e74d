"""A recognised body written as a skeleton mapping, for a person to read and edit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from kinedex.catalog.configs import scalar
from kinedex.catalog.skeletons.skeleton_fit import KINDS, SEEN, Fit, Mix, SkeletonMapping
from kinedex.ops.arrays import F64

_HELP = (
    "# Edit what is wrong. Left are the joints, which keep their names; right is what each is made of:",
    "#   a node: LeftFoot",
    "#   several nodes, by weights: {nodes: {LASI: 0.5, RASI: 0.5}}; below markers on the skin, off a plane:",
    "#     {nodes: {LASI: 1}, aside: {plane: [LASI, RASI, SACR], times: 0.1}}",
    "#   other joints, by weights: {virtual: {neck: -1, head: 2}}",
    "#   null, where there is no such joint; or a list of these, of which the first that is there counts",
    "# up and facing are axes of the file; unit_m is the metres of its unit, or guess.",
)


def mapping_yaml(fit: Fit, name: str | None = None) -> str:
    """Return the mapping of a fit as YAML that `load_skeleton` reads.

    Parameters
    ----------
    fit : Fit
        A recognised body, or a proposal for one.
    name : str, optional
        The name of the mapping; that of the fit's own by default.

    Returns
    -------
    str
        Comments state how the body was recognised, and which joints are estimated or unknown.
    """
    used = {node for mix in fit.joints.values() if mix is not None for node in mix.names}
    unused = [node for node in fit.indices if node not in used]
    mapping, prefix = _without_subject(fit)
    lines = [f"# Recognised with a confidence of {fit.confidence:.2f}:"]
    lines += [f"# - {' '.join(reason.split())}" for reason in fit.reasons]
    lines += ["", *_HELP]
    _, up, ahead = (_axis(row) for row in mapping.axes)
    handed = "right" if np.linalg.det(mapping.axes) > 0 else "left"
    lines += ["", f"name: {scalar(name or mapping.name)}", f"format: {mapping.format}"]
    if prefix:
        lines.append(f"strip_prefix: {scalar(prefix)}  # the name of the subject")
    lines += [f"up: {scalar(up)}", f"handedness: {handed}", f"facing: {scalar(ahead)}"]
    if mapping.format in ("acclaim", "bvh", "amass") and not np.array_equal(mapping.root_axes, mapping.axes):
        _, root_up, root_ahead = (scalar(_axis(row)) for row in mapping.root_axes)
        lines.append(f"root_axes: {{up: {root_up}, facing: {root_ahead}}}")
    unit = "guess" if mapping.unit_m is None else f"{mapping.unit_m:.9g}"
    lines.append(f"unit_m: {unit}")
    if mapping.bones:
        lines += ["", "bones:  # have no length in the file"]
    for bone, weights in mapping.bones.items():
        lines.append(f"  {scalar(bone)}: {{{_weights(weights.items())}}}")
    lines += ["", "joints:"]
    for joint, mixes in mapping.joints.items():
        choices = [_mix(mix) for mix in mixes if mix is not None]
        if not choices:
            lines.append(f"  {joint}: null  # not found")
        else:
            lines.append(f"  {joint}: {choices[0] if len(choices) == 1 else '[' + ', '.join(choices) + ']'}")
    guessed = {joint: how for joint, how in fit.estimated.items() if fit.joints.get(joint) is not None}
    if guessed:
        lines += ["", "estimated:  # joints that the file does not hold; drop those that you have given a node"]
        lines += [f"  {joint}: {scalar(how)}" for joint, how in guessed.items()]
    if rough := [joint for joint in fit.rough if joint in guessed]:
        lines.append(f"rough: [{', '.join(rough)}]  # those of them that may be more than 5 cm off")
    lines += ["", f"# Nodes that no joint is made of: {', '.join(map(scalar, unused)) or 'none'}", ""]
    return "\n".join(lines)


def _without_subject(fit: Fit) -> tuple[SkeletonMapping, str]:
    """Return the mapping of a fit without the subject before labels of markers, such as `Ann:LKNE`, if there is one.

    The second value is the regular expression of what was removed, so that the mapping fits other subjects, too; empty
    where labels have no subject, or several that share labels.
    """
    mapping = fit.mapping
    used = {
        node for mixes in mapping.joints.values() for mix in mixes if mix and not mix.of_joints for node in mix.names
    }
    short = Counter(_label(node) for node in fit.indices)
    subjects = {node.removesuffix(_label(node)) for node in used}
    if (
        mapping.format not in SEEN
        or len(subjects) != 1
        or "" in subjects
        or any(short[_label(node)] > 1 for node in used)
    ):
        return mapping, ""

    def shortened(mix: Mix) -> Mix:
        if mix.of_joints:
            return mix
        weights = tuple((_label(node), weight) for node, weight in mix.weights)
        plane = tuple(shortened(one) if isinstance(one, Mix) else _label(one) for one in mix.plane)
        return replace(mix, weights=weights, plane=plane)

    joints = {
        joint: tuple(None if mix is None else shortened(mix) for mix in mixes)
        for joint, mixes in mapping.joints.items()
    }
    return replace(mapping, joints=joints), ".*:"


def _label(node: str) -> str:
    """Return a label without its subject."""
    return node.rpartition(":")[2]


def _axis(row: F64) -> str:
    index = int(np.argmax(np.abs(row)))
    return ("-" if row[index] < 0 else "") + "xyz"[index]


def _mix(mix: Mix) -> str:
    if mix.node is not None:
        return scalar(mix.node)
    weights = _weights(_rounded(mix))
    if mix.of_joints:
        return f"{{virtual: {{{weights}}}}}"
    if not mix.plane:
        return f"{{nodes: {{{weights}}}}}"
    plane = ", ".join(scalar(part) if isinstance(part, str) else _mix(part) for part in mix.plane)
    kind = next((f", kind: {kind}" for kind, made in KINDS.items() if kind != "normal" and type(mix) is made), "")
    return f"{{nodes: {{{weights}}}, aside: {{plane: [{plane}], times: {mix.out:.6g}{kind}}}}}"


def _weights(pairs: Iterable[tuple[str, float]]) -> str:
    return ", ".join(f"{scalar(name)}: {weight:.6g}" for name, weight in pairs)


def _rounded(mix: Mix) -> list[tuple[str, float]]:
    """Return the weights with six digits behind the point, the last one so that they add up to 1."""
    names, weights = [name for name, _ in mix.weights], [round(weight, 6) for _, weight in mix.weights]
    weights[-1] = round(1.0 - sum(weights[:-1]), 6)
    return list(zip(names, weights, strict=True))
