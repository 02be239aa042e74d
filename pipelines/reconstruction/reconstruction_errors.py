"""Evaluate reconstructed takes by ground truth: joints, or markers that are fixed to body parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.depth_recordings import DepthRecordingsFile, WorldPose
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.body.kinematic_chain import forward
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.ops.depth.pose_distance import COMPARED, END_EFFECTORS, are_ends_found
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.tracking.recorded_takes import TruePositions, at_rate, read_truth
from kinedex.storage.formats.depth.recording import recording_truth
from kinedex.storage.formats.motion.c3d import Markers, parse_c3d
from kinedex.storage.formats.motion.positions import parse_positions
from kinedex.storage.store.store import Store

OFF_M = 0.1
"""The error, in metres, above which a frame counts as off."""

OFFSET_SECONDS = 1.0
"""The length, in seconds, of the part of a recording from which marker positions on body parts are fitted."""

_LARGEST_ROOM = 50.0  # larger coordinates in a file without a unit are taken for millimetres
_UPRIGHT = {"z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), "x": np.array([[0, 0, -1.0], [1, 0, 0], [0, -1, 0]])}
"""Rotations from axes whose z or x points upwards to axes with Y up."""

_MARKER_FILES = (".c3d", ".trc", ".csv", ".npz", ".npy")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A stored reconstructed take, at the rate of its recording.

    Attributes
    ----------
    row : dict
        Its row of `reconstructions`.
    poses : float64 array (T, 24, 3)
        The joint positions in the world in metres; NaN without a person.
    extrema : float64 array (T, 5, 3)
        The first five geodesic extrema in metres; NaN if there are fewer.
    """

    row: Mapping[str, Any]
    poses: F64
    extrema: F64


@dataclass(frozen=True, eq=False)
class Comparison:
    """The distances of a take from its truth.

    Attributes
    ----------
    row : dict
        Its row of `reconstructions`.
    reference : str
        The name of the truth.
    names : tuple of str
        The names of the joints or markers.
    gaps : float64 array (T, J)
        Distances in metres; NaN if one of the two positions is unknown.
    known : bool array (T,)
        Frames in which the truth is known.
    ends : bool array (T,)
        Frames in which all five end effectors are found; None for markers.
    offsets : dict of str to float64 array (3,)
        The position of each marker in the axes of its body part, in metres.
    """

    row: Mapping[str, Any]
    reference: str
    names: tuple[str, ...]
    gaps: F64
    known: Bool
    ends: Bool | None
    offsets: Mapping[str, F64] = field(default_factory=dict)


def stored_reconstruction(row: Mapping[str, Any], frames: pa.Table) -> Reconstruction:
    """Return a reconstructed take from its stored rows.

    Parameters
    ----------
    row : dict
        Its row of `reconstructions`.
    frames : pyarrow.Table
        Its rows of `reconstruction_frames`.
    """
    poses = np.full((row["source_frames"], len(JOINTS), 3), np.nan)
    extrema = np.full((row["source_frames"], len(END_EFFECTORS), 3), np.nan)
    for one in frames.select(["source_frame", "joints", "extrema"]).to_pylist():
        if one["joints"] is not None:
            poses[one["source_frame"]] = np.reshape(one["joints"], (-1, 3))
            extrema[one["source_frame"]] = np.reshape(one["extrema"], (-1, 3))[: len(END_EFFECTORS)]
    return Reconstruction(row, poses, extrema)


def compare_with_truth(
    store: Store, found: Reconstruction, file: DepthRecordingsFile, truth: str | None
) -> Comparison | None:
    """Compare a take with its truth.

    Parameters
    ----------
    store : Store
        The store.
    found : Reconstruction
        The take.
    file : DepthRecordingsFile
        The file of its recording.
    truth : str, optional
        A take or a motion file; by default the truth that the recording names.

    Returns
    -------
    Comparison or None
        The distances; None if no truth is known.

    Raises
    ------
    KinedexError
        The truth cannot be read, or no joint of it is known in a common frame.
    """
    name = str(found.row["recording"])
    entry = file.entry(name)
    given = truth if truth is not None else recording_truth(file, name)
    if given is None:
        return None
    if entry.markers and truth is None:
        return _compare_markers(found, file, Path(given))
    known = true_positions(store, file, name, str(given), float(found.row["rate_hz"]), JOINTS)
    poses, own = found.poses, known.joints.transpose(2, 0, 1)
    count = min(len(poses), len(own))
    gaps = np.linalg.norm(poses[:count, COMPARED] - own[:count, COMPARED], axis=2)
    if not np.isfinite(gaps).any():
        raise KinedexError(f"{found.row['take']}: no joint is known to the truth '{known.name}' in any common frame")
    ends = are_ends_found(found.extrema[:count], own[:count])
    names = tuple(JOINTS[j] for j in COMPARED.tolist())
    known_frames: Bool = np.any(np.isfinite(own[:count, COMPARED]), axis=(1, 2))
    return Comparison(found.row, given.name if isinstance(given, Path) else given, names, gaps, known_frames, ends)


def true_positions(
    store: Store, file: DepthRecordingsFile, name: str, truth: str, rate_hz: float, joints: tuple[str, ...]
) -> TruePositions:
    """Return the true joint positions of a recording in the world, at a given rate.

    Parameters
    ----------
    store : Store
        The store.
    file : DepthRecordingsFile
        The file of the recording.
    name : str
        Its name.
    truth : str
        A take, or a motion file.
    rate_hz : float
        Frames per second of the result, and of a file that does not state its rate.
    joints : tuple of str
        The joints, in the order of the result.

    Raises
    ------
    KinedexError
        The truth cannot be read.
    """
    known = read_truth(store, truth, Path(), joints, rate_hz)
    positions = _in_world(at_rate(known.joints, known.rate_hz, rate_hz), file.entry(name).truth_pose)
    return TruePositions(known.name, positions, rate_hz)


def _in_world(positions: F64, pose: WorldPose | None) -> F64:
    """Return positions (J, 3, T) moved by a pose into the world; without a pose they are unchanged."""
    if pose is None:
        return positions
    turned: F64 = np.einsum("ab,jbt->jat", np.array(pose.rotation), positions) + np.array(pose.place)[None, :, None]
    return turned


def _compare_markers(found: Reconstruction, file: DepthRecordingsFile, path: Path) -> Comparison:
    name, rate_hz = str(found.row["recording"]), float(found.row["rate_hz"])
    entry = file.entry(name)
    markers, source_hz = _markers(file, name, path)
    positions = _in_world(at_rate(markers, source_hz or rate_hz, rate_hz), entry.truth_pose).transpose(2, 0, 1)
    count = min(len(found.poses), len(positions))
    positions, poses = positions[:count], found.poses[:count]
    chain = load_kinematic_chain()
    seen = np.isfinite(poses).all(axis=(1, 2))
    joints = np.ascontiguousarray(poses[seen][:, [JOINTS.index(one) for one in chain.joints]].transpose(1, 2, 0))
    body = measured_body(chain, joints)
    rotations = np.full((count, len(chain.nodes), 3, 3), np.nan)
    rotations[seen] = forward(body, fit_poses(body, joints))[1]
    gaps, offsets = np.full((count, len(entry.markers)), np.nan), {}
    for m, (marker, joint) in enumerate(entry.markers.items()):
        turn = rotations[:, chain.rest[chain.joint(joint)].node]
        away = positions[:, m] - poses[:, JOINTS.index(joint)]
        own = np.einsum("tba,tb->ta", turn, away)
        usable = np.flatnonzero(np.isfinite(own).all(axis=1))
        if not len(usable):
            raise KinedexError(f"{found.row['take']}: marker '{marker}' of {path.name} is seen in no frame with a pose")
        first = usable[usable < usable[0] + max(1, round(OFFSET_SECONDS * rate_hz))]
        offsets[marker] = own[first].mean(axis=0)
        gaps[:, m] = np.linalg.norm(own - offsets[marker], axis=1)
    known: Bool = np.any(np.isfinite(positions).all(axis=2), axis=1)
    return Comparison(found.row, path.name, tuple(entry.markers), gaps, known, None, offsets)


def _markers(file: DepthRecordingsFile, name: str, path: Path) -> tuple[F64, float | None]:
    """Return the markers (M, 3, T) that a recording names, in metres with Y up, and their rate if it is stated."""
    entry = file.entry(name)
    ending = path.suffix.lower()
    if ending not in _MARKER_FILES:
        listed = ", ".join(_MARKER_FILES)
        raise file.error(name, "truth", f"'{path.name}' holds no markers that are read; expected one of {listed}")
    points = parse_c3d(path) if ending == ".c3d" else parse_positions(path)
    at = points.indices()
    rows = []
    for marker, joint in entry.markers.items():
        if marker not in at:
            raise file.error(name, "markers", f"{path.name} has no marker '{marker}'{did_you_mean(marker, at)}")
        if joint not in JOINTS:
            raise file.error(name, "markers", f"no joint is called '{joint}'{did_you_mean(joint, JOINTS)}")
        rows.append(points.positions[at[marker]])
    positions = np.stack(rows)
    largest = float(np.nanmax(np.abs(positions)))
    positions = positions * (points.unit_m or (0.001 if largest > _LARGEST_ROOM else 1.0))
    if entry.truth_pose is None and isinstance(points, Markers) and points.up in _UPRIGHT:
        positions = np.einsum("ab,jbt->jat", _UPRIGHT[points.up], positions)
    return positions, points.rate_hz or points.clock_hz


def error_rows(found: Sequence[Comparison]) -> list[dict[str, Any]]:
    """Return the rows of `reconstruction_errors`: for each take and its joints, and for all takes together."""
    rows: list[dict[str, Any]] = []
    for one in found:
        own = {"take_id": one.row["take_id"], "take": one.row["take"], "reference": one.reference}
        rows.append(own | _statistics("take", "all", one.gaps, one.known) | {"rate_five_ends": _rate(one)})
        for j, name in enumerate(one.names):
            offset = one.offsets.get(name)
            statistics = _statistics("joint", name, one.gaps[:, j : j + 1], one.known)
            rows.append(own | statistics | {"offset_m": None if offset is None else offset.tolist()})
    if found:
        frames = np.concatenate([_means(one.gaps) for one in found])[:, None]
        known = np.concatenate([one.known for one in found])
        whole = _statistics("all", "all", frames, known)
        judged = [one for one in found if one.ends is not None]
        counts = [np.isfinite(one.gaps).any(axis=1).sum() for one in judged]
        rates = [_rate(one) or 0.0 for one in judged]
        whole["rate_five_ends"] = float(np.average(rates, weights=counts)) if sum(counts) else None
        rows.append(whole)
    return rows


def _means(gaps: F64) -> F64:
    """Return the mean distance of each frame, float64 (T,), over known values; NaN if there are none."""
    seen = np.isfinite(gaps)
    counts = seen.sum(axis=1)
    sums = np.where(seen, gaps, 0.0).sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _rate(one: Comparison) -> float | None:
    """Return the fraction of the frames with a pose in which all five end effectors are found; None if not known."""
    seen = np.isfinite(one.gaps).any(axis=1)
    return None if one.ends is None or not seen.any() else float(one.ends[seen].mean())


def _statistics(scope: str, name: str, gaps: F64, known: Bool) -> dict[str, Any]:
    """Return a row with statistics of the mean distance of each frame, from distances (T, J) in metres."""
    means = _means(gaps)
    frames = means[np.isfinite(means)]
    found: dict[str, Any] = {
        "scope": scope,
        "name": name,
        "frames": len(frames),
        "unseen_frames": int((known & ~np.isfinite(means)).sum()),
    }
    if len(frames):
        found |= {
            "mean_m": float(frames.mean()),
            "std_m": float(frames.std()),
            "median_m": float(np.median(frames)),
            "p90_m": float(np.percentile(frames, 90)),
            "over_10cm": float((frames > OFF_M).mean()),
        }
    return found
