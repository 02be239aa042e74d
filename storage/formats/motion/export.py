"""Takes written back out: joint positions as CSV or Parquet, and a BVH of the named joints."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.storage.snapshot.manifest import TEMPORARY
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

TREE = {
    "root": None, "lhip": "root", "lknee": "lhip", "lankle": "lknee", "ltoes": "lankle",
    "rhip": "root", "rknee": "rhip", "rankle": "rknee", "rtoes": "rankle",
    "belly": "root", "chest": "belly", "neck": "chest", "head": "neck", "headtop": "head",
    "lclavicle": "neck", "lshoulder": "lclavicle", "lelbow": "lshoulder", "lwrist": "lelbow", "lfingers": "lwrist",
    "rclavicle": "neck", "rshoulder": "rclavicle", "relbow": "rshoulder", "rwrist": "relbow", "rfingers": "rwrist",
}  # fmt: skip
"""Named joint → the joint it hangs from."""


def export_take(store: Store, take: str, form: str, path: Path) -> None:
    """Write a take's joint positions (metres, Y up, analysis rate) to a file, whole or not at all.

    Parameters
    ----------
    form: "csv" (frame, then x, y, z of each joint), "parquet" (the rows of `frames`), or "bvh".

    Raises
    ------
    KinedexError: no such take or form, or a BVH of a take that lacks joints.
    """
    writers: dict[str, Callable[[Store, str, Path], None]] = {
        "csv": _write_csv, "parquet": _write_parquet, "bvh": _write_bvh,
    }  # fmt: skip
    if form not in writers:
        raise KinedexError(f"no export format '{form}'{did_you_mean(form, writers)}")
    store.take_id(take)
    temporary = path.with_name(f"{TEMPORARY}{uuid.uuid4().hex}")
    try:
        writers[form](store, take, temporary)
        os.replace(temporary, path)
    except OSError as fault:
        raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None
    finally:
        temporary.unlink(missing_ok=True)


def _write_parquet(store: Store, take: str, path: Path) -> None:
    pq.write_table(store.frames(take), path)


def _write_csv(store: Store, take: str, path: Path) -> None:
    rows = store.frames(take)
    columns = {"frame": rows.column("frame")}
    for joint, track in zip(store.feature_set.joints, _positions(store, rows), strict=True):
        columns |= {f"{joint}_{axis}": pa.array(values) for axis, values in zip("xyz", track, strict=True)}
    pa_csv.write_csv(pa.table(columns), path)


def _positions(store: Store, rows: pa.Table) -> npt.NDArray[np.float32]:
    return joint_positions(rows, store.feature_set.joints)


def _write_bvh(store: Store, take: str, path: Path) -> None:
    """Every joint with six channels: a turn that fits its children best, and its exact place in its parent's axes.

    Positions are exact so; a skeleton of bones of fixed length could not hold the named joints, between which other
    joints of the source bend.
    """
    joints = store.feature_set.joints
    track = {
        joint: p.T.astype(np.float64) for joint, p in zip(joints, _positions(store, store.frames(take)), strict=True)
    }
    unknown = [joint for joint in TREE if joint not in track or not np.isfinite(track[joint]).any()]
    if unknown:
        raise KinedexError(
            f"take '{take}' has no {', '.join(unknown)}; a BVH needs every joint (csv and parquet do not)"
        )
    lost = [joint for joint in TREE if not np.isfinite(track[joint]).all()]
    if lost:
        gone = np.isnan(np.array([track[joint] for joint in lost])).any(axis=(0, 2))
        raise KinedexError(
            f"take '{take}' is invalid in {np.count_nonzero(gone)} of its {len(gone)} frames, where {', '.join(lost)} "
            "have no place; a BVH needs every joint in every frame. Export csv or parquet, or ingest the take again "
            "with a larger fill_gap_frames, which closes longer gaps"
        )
    turns = {joint: _turns(track, joint) for joint in TREE}
    lines = ["HIERARCHY"]
    columns: list[F64] = []
    _describe(track, turns, "root", 0, lines, columns)
    lines += ["MOTION", f"Frames: {len(track['root'])}", f"Frame Time: {1.0 / store.rate_hz:.8f}"]
    with path.open("w", encoding="ascii") as file:
        file.write("\n".join(lines) + "\n")
        np.savetxt(file, np.concatenate(columns, axis=1), fmt="%.6f")


def _children(joint: str) -> list[str]:
    return [name for name, parent in TREE.items() if parent == joint]


def _turns(track: dict[str, F64], joint: str) -> F64:
    """The rotation (T, 3, 3) of a joint's children from frame 0, best in the sense of least squares (Kabsch)."""
    arms = [track[child] - track[joint] for child in _children(joint)]
    if not arms:
        return np.broadcast_to(np.eye(3), (len(track[joint]), 3, 3))
    rest = np.stack([arm[0] for arm in arms])
    now = np.stack(arms, axis=1)
    u, _, vt = np.linalg.svd(np.einsum("tca,cb->tab", now, rest))
    flip = np.ones((len(u), 3))
    flip[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    best: F64 = np.einsum("tab,tb,tbc->tac", u, flip, vt)
    return best


def _describe(
    track: dict[str, F64], turns: dict[str, F64], joint: str, depth: int, lines: list[str], columns: list[F64]
) -> None:
    pad, parent = "\t" * depth, TREE[joint]
    arm = track[joint] - track[parent] if parent else track[joint]
    above = turns[parent] if parent else np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    place = np.einsum("tba,tb->ta", above, arm)
    local = np.einsum("tba,tbc->tac", above, turns[joint])
    lines += [f"{pad}{'JOINT' if parent else 'ROOT'} {joint}", f"{pad}{{"]
    lines.append(f"{pad}\tOFFSET " + " ".join(f"{x:.6f}" for x in (place[0] if parent else np.zeros(3))))
    lines.append(f"{pad}\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation")
    columns += [place, _zxy_degrees(local)]
    children = _children(joint)
    for child in children:
        _describe(track, turns, child, depth + 1, lines, columns)
    if not children:
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0.000000 0.000000 0.000000", f"{pad}\t}}"]
    lines.append(f"{pad}}}")


def _zxy_degrees(matrices: F64) -> F64:
    """Angles (T, 3) z, x, y in degrees with R = Rz · Rx · Ry; where X stands at a right angle, y is 0."""
    sine = np.clip(matrices[:, 2, 1], -1.0, 1.0)
    level = np.abs(sine) < 1.0 - 1e-12
    z = np.where(
        level, np.arctan2(-matrices[:, 0, 1], matrices[:, 1, 1]), np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    )
    y = np.where(level, np.arctan2(-matrices[:, 2, 0], matrices[:, 2, 2]), 0.0)
    degrees: F64 = np.rad2deg(np.stack([z, np.arcsin(sine), y], axis=1))
    return degrees
