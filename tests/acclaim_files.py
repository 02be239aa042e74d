"""Acclaim files for tests: skeletons and motions written out as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

SKELETON = {
    "root_order": ["tx", "ty", "tz", "rx", "ry", "rz"],
    "root_axis": "XYZ",
    "root_orientation": [0.0, 0.0, 0.0],
    "root_position": [0.0, 0.0, 0.0],
    "bones": {
        "hip": {
            "parent": "root", "direction": [1, -0.5, 0], "length": 2.0, "axis": [0, 0, 0], "order": "XYZ", "dofs": [],
        },
        "thigh": {
            "parent": "hip", "direction": [0, -1, 0], "length": 7.5, "axis": [10, 20, 30], "order": "XYZ",
            "dofs": ["rx", "ry", "rz"],
        },
        "shin": {
            "parent": "thigh", "direction": [0.3, -0.9, 0.1], "length": 7.0, "axis": [0, 0, 20], "order": "ZYX",
            "dofs": ["rx"],
        },
        "spine": {
            "parent": "root", "direction": [0, 1, 0], "length": 4.0, "axis": [5, 0, -90], "order": "YZX",
            "dofs": ["rz", "rx"],
        },
    },
}  # fmt: skip
"""A small skeleton with everything that Acclaim bones can have."""


def asf_text(skeleton: Mapping = SKELETON, *, length: float = 0.45, angle: str = "deg", newline: str = "\n") -> str:
    """The skeleton as an ASF file."""
    lines = [
        "# written for a test", ":version 1.10", ":name VICON", ":units", "  mass 1.0", f"  length {length}",
        f"  angle {angle}", ":documentation", "   Caf\xe9 :bonedata in the middle of a line", ":root",
        "   order " + " ".join(dof.upper() for dof in skeleton["root_order"]),
        f"   axis {skeleton['root_axis']}",
        "   position " + " ".join(map(str, skeleton["root_position"])),
        "   orientation " + " ".join(map(str, skeleton["root_orientation"])),
        ":bonedata",
    ]  # fmt: skip
    for number, (name, bone) in enumerate(skeleton["bones"].items(), 1):
        lines += [
            "  begin", f"     id {number}", f"     name {name}",
            "     direction " + " ".join(map(str, bone["direction"])), f"     length {bone['length']}  # a comment",
            "     axis " + " ".join(map(str, bone["axis"])) + f"  {bone['order']}",
        ]  # fmt: skip
        if bone["dofs"]:
            lines += ["    dof " + " ".join(bone["dofs"]), "    limits (-160.0 20.0)"]
            lines += ["           (-70.0 70.0)"] * (len(bone["dofs"]) - 1)
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    parents: dict[str, list[str]] = {}
    for name, bone in skeleton["bones"].items():
        parents.setdefault(bone["parent"], []).append(name)
    lines += ["    " + " ".join([parent, *children]) for parent, children in parents.items()]
    return newline.join([*lines, "  end", ""])


def amc_text(
    frames: Sequence[Mapping[str, Sequence[float]]],
    *,
    header: str = ":FULLY-SPECIFIED\n:DEGREES\n",
    newline: str = "\n",
) -> str:
    """Frames (bone → its numbers) as an AMC file."""
    lines = header.splitlines()
    for number, frame in enumerate(frames, 1):
        lines.append(str(number))
        lines += [" ".join([name, *(repr(float(value)) for value in values)]) for name, values in frame.items()]
    return newline.join([*lines, ""])


def rest(frames: int = 3) -> list[dict[str, list[float]]]:
    """The small skeleton in its rest pose."""
    return [
        {"root": [0.0, 17.0, float(t), 0.0, 0.0, 0.0], "thigh": [0.0] * 3, "shin": [0.0], "spine": [0.0, 0.0]}
        for t in range(frames)
    ]
