"""Evaluate tracked and stabilised takes: by the truth, a take or a file of positions, and by worn sensors."""

from __future__ import annotations

import csv
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import ChainBody, forward
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inertial.limb_error_curves import judged_limbs
from kinedex.pipelines.recordings.truth import Truth, at_rate, read_truth
from kinedex.pipelines.tracking.tracked_takes import stored_poses
from kinedex.storage.store.store import Store

LIMBS = tuple(side + name for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for side in "lr")
"""The joints that are compared."""

FAILURES = "failures.csv"
"""A table beside a truth file, with columns recording, start, stop: intervals where a simulated detector fails."""


def truth_reference(store: Store, truth: str, folder: Path, recording: str | None) -> Truth:
    """Return the truth of a recording.

    Parameters
    ----------
    store : Store
        The store.
    truth : str
        A take of the store, or a motion file of any format, with joints as positions or angles.
    folder : Path
        The folder that relative paths start from.
    recording : str, optional
        The name of the recording, by which failures are looked up.

    Raises
    ------
    KinedexError
        `truth` is neither a take nor a motion file.
    """
    found = read_truth(store, truth, folder, load_kinematic_chain().joints)
    if truth in store.take_ids:
        return found
    return replace(found, failures=_failures((folder / Path(truth).expanduser()).parent / FAILURES, recording))


def _failures(file: Path, recording: str | None) -> tuple[tuple[int, int], ...]:
    if recording is None or not file.is_file():
        return ()
    try:
        with file.open(encoding="utf-8", newline="") as text:
            rows = [row for row in csv.DictReader(text) if row["recording"] == recording]
            return tuple((int(row["start"]), int(row["stop"])) for row in rows)
    except (KeyError, TypeError, ValueError, UnicodeDecodeError) as fault:
        expected = "expected columns recording, start and stop with whole numbers"
        raise KinedexError(f"{file}: {expected}: {fault!r}") from None


def compared(row: dict[str, Any], poses: pa.Table, reference: Truth) -> list[dict[str, Any]]:
    """Return error statistics of a track against a reference.

    Parameters
    ----------
    row : dict
        The row of the track in the results `tracks`.
    poses : pyarrow.Table
        Its rows of `chain_poses`.
    reference : Truth
        The reference; only frames that both have are compared.

    Raises
    ------
    KinedexError
        No joint is known in both in any frame.
    """
    chain = load_kinematic_chain()
    body = ChainBody(chain, np.array(row["body"], np.float64).reshape(-1, 3))
    own, _ = forward(body, stored_poses(poses, len(chain.nodes)))
    known = at_rate(reference.joints, reference.rate_hz, row["rate_hz"])
    frames = min(own.shape[2], known.shape[2])
    order = [chain.joint(name) for name in LIMBS]
    gaps = 1000.0 * np.linalg.norm(own[order, :, :frames] - known[order, :, :frames], axis=1)
    if not np.isfinite(gaps).any():
        raise KinedexError(f"{row['take']}: no joint of the limbs is known to '{reference.name}' in any common frame")
    rows = [_figures("take", "all", gaps)]
    rows += [_figures("joint", name, gaps[j : j + 1]) for j, name in enumerate(LIMBS)]
    if reference.failures:
        failing = np.zeros(frames, np.bool_)
        for start, stop in reference.failures:
            share = row["rate_hz"] / reference.rate_hz
            failing[round(start * share) : round(stop * share)] = True
        rows += [_figures("part", "in failures", gaps[:, failing]), _figures("part", "elsewhere", gaps[:, ~failing])]
    named = {"take_id": row["take_id"], "take": row["take"], "reference": reference.name}
    return [named | one for one in rows if one["frames"]]


def _figures(scope: str, name: str, gaps: F64) -> dict[str, Any]:
    """Return statistics of distances (J, T) in millimetres, without unknown joints."""
    seen = np.isfinite(gaps)
    count = seen.sum(axis=0)
    frames = np.where(seen, gaps, 0.0).sum(axis=0)[count > 0] / count[count > 0]
    own = gaps[seen]
    return {
        "scope": scope,
        "name": name,
        "frames": len(frames),
        "mean_mm": float(frames.mean()) if len(frames) else None,
        "sd_mm": float(frames.std()) if len(frames) else None,
        "median_mm": float(np.median(own)) if len(own) else None,
        "max_mm": float(frames.max()) if len(frames) else None,
    }


def poses_of(store: Store, stage: str, take_id: int) -> pa.Table:
    """Return the rows of `chain_poses` that a stage has stored for a take."""
    found = store.rows_of("chain_poses", stage, "take_id", [take_id])
    return found.take(pc.sort_indices(found, [("source_frame", "ascending")]))


SENSORS, LIMB = "sensors", "limb"
"""The reference of evaluations by sensors (also the scope of all limbs together), and the scope of a single limb."""


def judged_by_sensors(store: Store, stage: str, take_ids: Collection[int]) -> list[dict[str, Any]]:
    """Return error statistics of takes against sensors: for all limbs of a take together, then for each limb.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored `limb_errors`, "<pipeline>/<stage>".
    take_ids : collection of int
        The ids of the takes to evaluate.
    """
    rows: list[dict[str, Any]] = []
    for limbs in judged_limbs(store, stage):
        own = [(one.limb, one.error[one.valid]) for one in limbs if one.take_id in take_ids and one.valid.any()]
        if not own:
            continue
        named = {"take_id": limbs[0].take_id, "take": limbs[0].take, "reference": SENSORS}
        rows.append(named | _angle_figures(SENSORS, "all", np.concatenate([error for _, error in own])))
        rows += [named | _angle_figures(LIMB, limb, error) for limb, error in own]
    return rows


def _angle_figures(scope: str, name: str, error: F64) -> dict[str, Any]:
    return {
        "scope": scope,
        "name": name,
        "frames": len(error),
        "mean_deg": float(error.mean()),
        "sd_deg": float(error.std()),
        "median_deg": float(np.median(error)),
        "max_deg": float(error.max()),
    }
