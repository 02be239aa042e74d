"""The writer of BVH files: named joints over time, each with six channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.joint_tree import JOINT_PARENTS

F64 = npt.NDArray[np.float64]


def write_bvh(path: Path, tracks: dict[str, F64], rate_hz: float) -> None:
    """Write a BVH file in which every joint has a turn that fits its children best, and its exact place.

    Places are in the parent's axes. A skeleton of bones of fixed length could not hold the named joints, between which
    other joints of the source bend.

    Parameters
    ----------
    path : Path
        The file to write.
    tracks : dict of str to float64 array (T, 3)
        Place of every named joint in metres, without NaN.
    rate_hz : float
        Frames per second.
    """
    turns = {joint: _turns(tracks, joint) for joint in JOINT_PARENTS}
    lines = ["HIERARCHY"]
    columns: list[F64] = []
    _describe(tracks, turns, "root", 0, lines, columns)
    lines += ["MOTION", f"Frames: {len(tracks['root'])}", f"Frame Time: {1.0 / rate_hz:.8f}"]
    with path.open("w", encoding="ascii") as file:
        file.write("\n".join(lines) + "\n")
        np.savetxt(file, np.concatenate(columns, axis=1), fmt="%.6f")


def _children(joint: str) -> list[str]:
    return [name for name, parent in JOINT_PARENTS.items() if parent == joint]


def _turns(tracks: dict[str, F64], joint: str) -> F64:
    """Return the rotation (T, 3, 3) of a joint's children from frame 0 by least squares (Kabsch's algorithm)."""
    arms = [tracks[child] - tracks[joint] for child in _children(joint)]
    if not arms:
        return np.broadcast_to(np.eye(3), (len(tracks[joint]), 3, 3))
    rest = np.stack([arm[0] for arm in arms])
    now = np.stack(arms, axis=1)
    u, _, vt = np.linalg.svd(np.einsum("tca,cb->tab", now, rest))
    flip = np.ones((len(u), 3))
    flip[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    best: F64 = np.einsum("tab,tb,tbc->tac", u, flip, vt)
    return best


def _describe(
    tracks: dict[str, F64], turns: dict[str, F64], joint: str, depth: int, lines: list[str], columns: list[F64]
) -> None:
    """Append the lines of a joint and of all joints below it, and their columns of motion."""
    pad, parent = "\t" * depth, JOINT_PARENTS[joint]
    arm = tracks[joint] - tracks[parent] if parent else tracks[joint]
    above = turns[parent] if parent else np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    place = np.einsum("tba,tb->ta", above, arm)
    local = np.einsum("tba,tbc->tac", above, turns[joint])
    lines += [f"{pad}{'JOINT' if parent else 'ROOT'} {joint}", f"{pad}{{"]
    lines.append(f"{pad}\tOFFSET " + " ".join(f"{x:.6f}" for x in (place[0] if parent else np.zeros(3))))
    lines.append(f"{pad}\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation")
    columns += [place, _zxy_degrees(local)]
    children = _children(joint)
    for child in children:
        _describe(tracks, turns, child, depth + 1, lines, columns)
    if not children:
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0.000000 0.000000 0.000000", f"{pad}\t}}"]
    lines.append(f"{pad}}}")


def _zxy_degrees(matrices: F64) -> F64:
    """Return angles (T, 3) z, x, y in degrees with R = Rz · Rx · Ry; y is 0 where x is a right angle."""
    sine = np.clip(matrices[:, 2, 1], -1.0, 1.0)
    level = np.abs(sine) < 1.0 - 1e-12
    z = np.where(
        level, np.arctan2(-matrices[:, 0, 1], matrices[:, 1, 1]), np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    )
    y = np.where(level, np.arctan2(-matrices[:, 2, 0], matrices[:, 2, 2]), 0.0)
    degrees: F64 = np.rad2deg(np.stack([z, np.arcsin(sine), y], axis=1))
    return degrees
