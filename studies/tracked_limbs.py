"""`python -m studies.tracked_limbs DATA`: print how far limbs of tracked takes are from those of the filmed ones.

DATA is a folder with cmu. Five takes are filmed by four simulated cameras, with failures of the detector, and tracked.
The orientations of limbs that follow from the joints of the track, and those of the nodes of its kinematic chain, are
compared with the rotations of nodes in the files. It takes a minute.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow.compute as pc
from rich.console import Console

import kinedex
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.console.terminal import Terminal
from kinedex.ops.body import kinematics
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.inertial.disagreement import direction_errors, frame_errors, mount_direction
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE, long_axis
from kinedex.ops.inertial.rotations import conjugate, distance_deg, interpolate, multiply
from kinedex.pipelines.inertial.limb_motion import TakeLimbs
from kinedex.pipelines.inertial.source_limbs import limb_tasks, read_limbs, with_stored_body
from kinedex.pipelines.simulation.simulated_cameras import RECORDINGS, CameraRequest, simulate_cameras
from kinedex.pipelines.tracking.tracked_takes import stored_poses
from kinedex.reports.markdown import grid
from kinedex.storage.store.store import Store, open_store

F64 = npt.NDArray[np.float64]

TAKES = ("01_14", "02_01", "02_05", "02_08", "02_09")
SEED = 3
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
ROBUST_DEG = 6.0
"""Scale of the weights with which the turn between two frames of a limb is fitted."""

NODES = {"pelvis": "pelvis", "torso": "spine2", "head": "head"} | {
    side + limb: side + node
    for side in "lr"
    for limb, node in {
        "upperarm": "shoulder", "forearm": "elbow", "hand": "wrist", "thigh": "hip", "shank": "knee", "foot": "ankle"
    }.items()
}  # fmt: skip
"""Limb → the node of the chain that begins at its near joint."""


def tracked(data: Path, folder: Path) -> Store:
    """Return a store with the takes, and the tracks of their recordings."""
    for take in TAKES:
        actor = data / "cmu" / take[:2]
        (folder / "takes").mkdir(exist_ok=True)
        for file in (actor / f"{take[:2]}.asf", actor / f"{take}.amc"):
            shutil.copy(file, folder / "takes")
    kinedex.run_pipeline("ingest", folder / "store", {"source": str(folder / "takes")})
    progress = Terminal(Console(file=io.StringIO())).progress
    request = CameraRequest(TAKES, seed=SEED)
    simulate_cameras(open_store(folder / "store", at="newest"), request, folder / "filmed", progress)
    kinedex.run_pipeline("track", folder / "store", {"recordings": str(folder / "filmed" / RECORDINGS)})
    return open_store(folder / "store", at="newest")


def chain_limbs(store: Store, take_id: int) -> tuple[F64, dict[str, F64]]:
    """Return the times of a track, and the rotations (T, 4) of the nodes of limbs."""
    (row,) = (one for one in store.result("tracks").to_pylist() if one["take_id"] == take_id)
    poses = store.result("chain_poses")
    own = stored_poses(poses.filter(pc.equal(poses.column("take_id"), take_id)), len(row["nodes"]))
    body = ChainBody(load_kinematic_chain(row["chain"]), np.array(row["body"]).reshape(-1, 3))
    turned = forward(body, own)[1]
    found = {}
    for limb, node in NODES.items():
        rows = np.ascontiguousarray(turned[:, body.chain.nodes.index(node)].reshape(-1, 9).T)
        found[limb] = np.ascontiguousarray(kinematics.quaternions(rows).T)
    return np.arange(len(turned)) / row["rate_hz"], found


def compared(times: F64, orientation: F64, truth: LimbMotion) -> F64:
    """Return the whole angle and the twist (T, 2) between a stream and the truth, whose frames may differ by a turn."""
    true, known = interpolate(truth.times, truth.orientation, times)
    good = known & np.isfinite(orientation).all(axis=1)
    between = multiply(conjugate(orientation[good]), true[good])
    weights, mount = np.ones(len(between)), IDENTITY
    for _ in range(15):
        mount = np.linalg.eigh((between * weights[:, None]).T @ between)[1][:, -1]
        apart = distance_deg(np.broadcast_to(mount, between.shape), between)
        weights = (ROBUST_DEG**2 / (ROBUST_DEG**2 + apart**2)) ** 2
    axis = long_axis(truth.orientation, truth.direction)
    found = frame_errors(true[good], multiply(orientation[good], mount), IDENTITY, IDENTITY, axis)
    return np.stack([found.degrees, found.twist], axis=1)


def swings(limb: LimbMotion, truth: LimbMotion) -> F64:
    """Return the swing (T, 1) between a long axis and the truth, after the best direction in the frame of the limb."""
    true, known = interpolate(truth.times, truth.orientation, limb.times)
    own = np.where(known[:, None], true, np.nan)
    found = direction_errors(own, limb.direction, IDENTITY, mount_direction(own, limb.direction, IDENTITY))
    return found[np.isfinite(found)][:, None]


def rows(store: Store) -> list[list[str]]:
    """Return a row for each limb: its basis, the errors by joints, and those of the chain's nodes."""
    by_joints, by_nodes = defaultdict[str, list[F64]](list), defaultdict[str, list[F64]](list)
    bases: dict[str, str] = {}
    for take in TAKES:
        (track,) = (name for name in store.take_ids if name.startswith(take) and name != take)
        truth, own = (_limbs(store, name) for name in (take, track))
        times, nodes = chain_limbs(store, store.take_ids[track])
        for limb in LIMB_NAMES:
            kind, true, one = limb[limb[0] in "lr" :], truth.limbs[limb], own.limbs[limb]
            bases[kind] = one.basis
            known = one.basis != NONE
            by_joints[kind].append(compared(one.times, one.orientation, true) if known else swings(one, true))
            by_nodes[kind].append(compared(times, nodes[limb], true))
    return [[kind, basis, *_cells(by_joints[kind]), *_cells(by_nodes[kind])] for kind, basis in bases.items()]


def _limbs(store: Store, take: str) -> TakeLimbs:
    (task,) = limb_tasks(store, [take], LIMB_NAMES)
    return read_limbs(with_stored_body(task, store))


def _cells(some: Sequence[F64]) -> list[str]:
    """Return median, 90 % and root mean square of the angles, and the median of the twists."""
    angles = np.concatenate(some)
    low, high = np.percentile(angles[:, 0], [50, 90])
    twist = f"{np.median(angles[:, 1]):.1f}" if angles.shape[1] > 1 else "–"
    return [f"{low:.1f}", f"{high:.1f}", f"{np.sqrt(np.mean(angles[:, 0] ** 2)):.1f}", twist]


def report(data: Path) -> str:
    """Return the table as Markdown."""
    with tempfile.TemporaryDirectory() as folder:
        store = tracked(data, Path(folder))
        columns = ["median", "90 %", "RMS", "twist"]
        heads = [f"{by}: {one}" for by in ("joints", "nodes") for one in columns]
        return "\n".join(grid(["limb", "basis", *heads], rows(store)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with cmu")
    print(report(parser.parse_args(arguments).data))
    return 0


if __name__ == "__main__":
    sys.exit(main())
