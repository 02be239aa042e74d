"""Write BVH files from the 24 named joints: the rotations of a kinematic chain, and positions at the root only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.euler import euler_angles
from kinedex.ops.body.kinematic_chain import ChainBody, KinematicChain, forward
from kinedex.ops.body.pose_fit import fit_poses, measured_body, start_poses
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.bvh_parser import frame_time
from kinedex.storage.formats.motion.joint_motion import JointMotion

F64 = npt.NDArray[np.float64]

ORDER = "ZXY"
"""The rotation channels of every joint: R = Rz · Rx · Ry."""

_BESIDE_M = 0.01  # metres; a joint nearer than this to another coincides with it

_CHANNELS = " ".join(f"{axis}rotation" for axis in ORDER)


def write_chain_bvh(path: Path, motion: JointMotion) -> None:
    """Write the joints of a motion as a BVH file with bones of fixed length, in metres with Y up.

    A kinematic chain is fitted to the joints; its bones have the median lengths of the motion; in the rest pose the
    body faces +Z with its arms to the sides. The root has three position and three rotation channels, every other joint
    three rotation channels, Z, X and Y.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.

    Raises
    ------
    KinedexError
        A joint is missing, in all frames or in some.
    """
    chain = load_kinematic_chain()
    positions = _all_joints(chain, motion)
    body = _with_clavicles(measured_body(chain, positions), positions)
    poses = fit_poses(body, positions)
    lines = ["HIERARCHY"]
    columns: list[F64] = [poses.positions]
    _describe(body, 0, "", lines, columns, poses.rotations)
    lines += ["MOTION", f"Frames: {len(poses.positions)}", f"Frame Time: {frame_time(motion.rate_hz)}"]
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        np.savetxt(file, np.concatenate(columns, axis=1) + 0.0, fmt="%.6f")


def _all_joints(chain: KinematicChain, motion: JointMotion) -> F64:
    """Return the joints (J, 3, T) in the order of the chain; raise a KinedexError that names missing ones."""
    seen = np.isfinite(motion.positions.sum(axis=2))
    known = {name: i for i, name in enumerate(motion.joints) if seen[:, i].any()}
    unknown = [name for name in chain.joints if name not in known]
    if unknown:
        raise KinedexError(
            f"take '{motion.name}' has no {', '.join(unknown)}; a BVH needs every joint (csv, npz and trc do not)"
        )
    order = [known[name] for name in chain.joints]
    lost = [name for name, i in zip(chain.joints, order, strict=True) if not seen[:, i].all()]
    if lost:
        gone = np.isnan(motion.positions[:, order].sum(axis=(1, 2)))
        raise KinedexError(
            f"take '{motion.name}' is invalid in {np.count_nonzero(gone)} of its {len(gone)} frames, where "
            f"{', '.join(lost)} have no place; a BVH needs every joint in every frame. Export csv or parquet, or "
            "ingest the take again with a larger fill_gap_frames, which closes longer gaps"
        )
    return np.ascontiguousarray(motion.positions[:, order].transpose(1, 2, 0), np.float64)


def _with_clavicles(body: ChainBody, positions: F64) -> ChainBody:
    """Return the body with clavicles that begin at the motion's joints on the chest, if these are not at the neck.

    In the chain, as in HDM05, clavicles begin at the neck and rotate about it; in other skeletons they begin beside it.
    """
    chain = body.chain
    poses = start_poses(body, positions)
    joints, turned = forward(body, poses)
    offsets = body.offsets.copy()
    for j, rest in enumerate(chain.rest):
        if rest.along is None and not rest.measured and rest.start != j:
            centre = joints[chain.centres[rest.node]]
            own = np.median(np.einsum("tba,bt->at", turned[:, rest.node], positions[j] - centre), axis=1)
            if np.linalg.norm(own - offsets[j]) > _BESIDE_M:
                offsets[j] = own
    return ChainBody(chain, offsets)


def _describe(body: ChainBody, node: int, pad: str, lines: list[str], columns: list[F64], rotations: F64) -> None:
    """Append the lines of a node and its descendants, and the columns of their rotations in degrees."""
    chain, inner = body.chain, pad + "\t"
    root = chain.parents[node] < 0
    offset = np.zeros(3) if root else body.offsets[chain.centres[node]]
    lines += [f"{pad}{'ROOT' if root else 'JOINT'} {_name(body, node)}", f"{pad}{{", f"{inner}OFFSET {_text(offset)}"]
    lines.append(f"{inner}CHANNELS {f'6 Xposition Yposition Zposition {_CHANNELS}' if root else f'3 {_CHANNELS}'}")
    columns.append(np.rad2deg(euler_angles(rotations[:, node], ORDER)))
    for child in (k for k, parent in enumerate(chain.parents) if parent == node):
        _describe(body, child, inner, lines, columns, rotations)
    names = {_name(body, k) for k in range(len(chain.nodes))}
    for j in (j for j, rest in enumerate(chain.rest) if rest.node == node and chain.joints[j] not in names):
        lines += [f"{inner}JOINT {chain.joints[j]}", f"{inner}{{", f"{inner}\tOFFSET {_text(body.offsets[j])}"]
        lines += [f"{inner}\tCHANNELS 3 {_CHANNELS}", f"{inner}\tEnd Site", f"{inner}\t{{"]
        lines += [f"{inner}\t\tOFFSET {_text(np.zeros(3))}", f"{inner}\t}}", f"{inner}}}"]
        columns.append(np.zeros((len(rotations), 3)))
    lines.append(f"{pad}}}")


def _name(body: ChainBody, node: int) -> str:
    """Return a joint's name in the file: that of the named joint at its position, else the node's own with a suffix."""
    chain = body.chain
    own, centre = chain.nodes[node], chain.centres[node]
    if own not in chain.joints:
        return chain.joints[centre] if chain.centres.index(centre) == node else own
    beside = np.any(body.offsets[chain.joint(own)] != body.offsets[centre])
    return f"{own}_turn" if beside else own


def _text(offset: F64) -> str:
    return " ".join(f"{value + 0.0:.6f}" for value in offset)
