"""A recognised body written as a skeleton mapping, for a person to read and edit."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import scalar
from kinedex.catalog.skeletons.skeleton_fit import Fit, Mix

F64 = npt.NDArray[np.float64]


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
    mapping = fit.mapping
    lines = [f"# Recognised with a confidence of {fit.confidence:.2f}. Edit what is wrong; a joint may be"]
    lines += ["#   a node, {nodes: {a: 0.5, b: 0.5}}, {virtual: {neck: -1, head: 2}} of other joints, or null."]
    lines += [f"# - {' '.join(reason.split())}" for reason in fit.reasons]
    _, up, ahead = (_axis(row) for row in mapping.axes)
    handed = "right" if np.linalg.det(mapping.axes) > 0 else "left"
    lines += ["", f"name: {scalar(name or mapping.name)}", f"format: {mapping.format}"]
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
        mix = mixes[0] if mixes else None
        if mix is None:
            lines.append(f"  {joint}: null  # not found")
        else:
            how = f"  # estimated: {fit.estimated[joint]}" if joint in fit.estimated else ""
            lines.append(f"  {joint}: {_mix(mix)}{how}")
    unused = [node for node in fit.places if node not in {n for m in fit.joints.values() if m for n in m.names}]
    lines += ["", f"# Nodes that no joint is made of: {', '.join(map(scalar, unused)) or 'none'}", ""]
    return "\n".join(lines)


def _axis(row: F64) -> str:
    index = int(np.argmax(np.abs(row)))
    return ("-" if row[index] < 0 else "") + "xyz"[index]


def _mix(mix: Mix) -> str:
    if mix.node is not None:
        return scalar(mix.node)
    weights = _weights(mix.weights)
    if mix.of_joints:
        return f"{{virtual: {{{weights}}}}}"
    if not mix.plane:
        return f"{{nodes: {{{weights}}}}}"
    plane = ", ".join(scalar(name) for name in mix.plane)
    return f"{{nodes: {{{weights}}}, aside: {{plane: [{plane}], times: {mix.out:.6g}}}}}"


def _weights(pairs: Iterable[tuple[str, float]]) -> str:
    return ", ".join(f"{scalar(name)}: {weight:.6g}" for name, weight in pairs)
