"""Compute the motion of a take's limbs from its source; write and read it as rows of `limb_orientations`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.limbs import LIMBS, Limb
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.limb_motion import LimbMotion, common_markers
from kinedex.ops.inertial.limb_orientation import (
    FULL,
    HINGE,
    NONE,
    SegmentFit,
    hinge_orientation,
    jumps,
    segment_orientation,
    unit_direction,
)
from kinedex.storage.formats.motion.body_limbs import BodyLimbs
from kinedex.storage.snapshot.schemas import columns_table, result_schema
from kinedex.storage.store.store import Store

_TRUNK = {"pelvis": ("root", "lhip", "rhip"), "torso": ("chest", "neck", "lshoulder", "rshoulder")}
"""The joints used as markers of a limb of the trunk that has neither a node nor markers."""

KIND = "limb_orientations"
_SUMS = [("take_id", "count"), ("jump", "sum")]


@dataclass(frozen=True, eq=False)
class TakeLimbs:
    """The limbs of a take.

    Attributes
    ----------
    rate_hz : float
        Frames per second of its source.
    limbs : dict of str to LimbMotion
        The limbs that are known, by name.
    lacking : dict of str to str
        Limb → the reason why it is unknown.
    remarks : tuple of str
        Sentences on limbs whose markers, joints of the trunk or hinges did not give an orientation.
    """

    rate_hz: float
    limbs: dict[str, LimbMotion]
    lacking: dict[str, str]
    remarks: tuple[str, ...] = ()


def take_limbs(segments: BodyLimbs, joints: Sequence[str], limbs: Iterable[str]) -> TakeLimbs:
    """Return the limbs of a take from the joints, node orientations and markers of its source.

    Parameters
    ----------
    segments : BodyLimbs
        Joints, node orientations and markers of the source.
    joints : sequence of str
        The named joints, in the order of the body.
    limbs : iterable of str
        The names of the limbs to return.
    """
    body = segments.body
    positions = {joint: body.positions[i].T for i, joint in enumerate(joints) if joint not in body.unknown}
    times = np.arange(body.frames) / body.rate_hz
    found: dict[str, LimbMotion] = {}
    lacking: dict[str, str] = {}
    remarks: list[str] = []
    for name in limbs:
        limb = LIMBS[name]
        near, far = (positions.get(joint) for joint in segments.ends.get(name, (limb.near, limb.far)))
        gap = np.full((body.frames, 3), np.nan)
        direction = unit_direction(near, far) if near is not None and far is not None else gap
        known = [place for place in (near, far) if place is not None]
        position = np.mean(known, axis=0) if known else gap
        basis, orientation, fit = _orientation(limb, segments, positions, remarks)
        if basis == NONE:
            reason = _missing(limb, positions, body.estimated)
            if reason:
                lacking[name] = reason
                continue
        valid = np.logical_and.reduce(np.isfinite(direction if basis == NONE else orientation), axis=1)
        jump = jumps(orientation, body.rate_hz)
        rms = None if fit is None else fit.rms_m
        found[name] = LimbMotion(name, basis, times, orientation, position, direction, valid, jump, rms)
    return TakeLimbs(body.rate_hz, found, lacking, tuple(remarks))


def _orientation(
    limb: Limb, segments: BodyLimbs, positions: dict[str, F64], remarks: list[str]
) -> tuple[str, F64, SegmentFit | None]:
    """Return the source of a limb's orientation (`LimbMotion.basis`), the orientation (T, 4), and a fit of markers.

    The fit is None if the orientation is not computed from markers of the limb.
    """
    if limb.name in segments.rotations:
        return FULL, segments.rotations[limb.name], None
    if limb.name in segments.markers:
        try:
            fit = segment_orientation(common_markers(segments.markers[limb.name]))
            return FULL, fit.orientation, fit
        except ParameterError as fault:
            remarks.append(f"{limb.name}: {fault}")
    trunk = _TRUNK.get(limb.name, ())
    if trunk and all(joint in positions for joint in trunk):
        try:
            fit = segment_orientation(np.stack([positions[joint] for joint in trunk], axis=1))
            return FULL, fit.orientation, None
        except ParameterError as fault:
            remarks.append(f"{limb.name}: {fault}")
    if limb.bend is not None and all(joint in positions for joint in (limb.near, limb.far, limb.bend)):
        beyond = JOINT_PARENTS[limb.bend] == limb.far
        orientation, valid = hinge_orientation(positions[limb.near], positions[limb.far], positions[limb.bend], beyond)
        if valid.any():
            return HINGE, orientation, None
        remarks.append(f"{limb.name}: the hinge never bends by 15°, so that only its long axis is known")
    return NONE, np.full((segments.body.frames, 4), np.nan), None


def _missing(limb: Limb, positions: dict[str, F64], estimated: Sequence[str]) -> str:
    """Return the reason why the direction of a limb is unknown; empty if it is known."""
    for joint in (limb.near, limb.far):
        if joint not in positions:
            return f"the skeleton has no {joint}"
        if joint in estimated:
            return f"{joint} is estimated, and no node turns with the limb"
    return ""


@dataclass(frozen=True, eq=False)
class StoredLimbs:
    """The stored limbs of a take.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take : str
        Its name.
    limbs : dict of str to LimbMotion
        Its limbs by name.
    """

    take_id: int
    take: str
    limbs: dict[str, LimbMotion]

    @property
    def rate_hz(self) -> float:
        """Frames per second; 0 for a take of one frame."""
        times = next(iter(self.limbs.values())).times
        # nine digits: times are multiples of 1/rate only up to the precision of doubles
        return float(f"{(len(times) - 1) / (times[-1] - times[0]):.9g}") if len(times) > 1 else 0.0


def limb_table(
    take_id: int, take: str, limbs: Mapping[str, LimbMotion], run: str, fingerprint: str | None = None
) -> pa.Table:
    """Return the rows of a take's limbs: limb by limb in the order of `limbs`, each with its frames in order."""
    shared = {"run": run, "take_id": take_id, "take": take, "fingerprint": fingerprint}
    tables = [columns_table(KIND, _columns(one), limb=one.limb, basis=one.basis, **shared) for one in limbs.values()]
    return pa.concat_tables(tables) if tables else result_schema(KIND).empty_table()


def limb_pieces(rows: pa.Table) -> Iterator[pa.Table]:
    """Yield the rows of a take limb by limb, so that one limb of a long take can be read without the others."""
    limbs = rows.column("limb").combine_chunks().dictionary_encode().indices.to_numpy() if rows.num_rows else ()
    for start, stop in _runs(np.asarray(limbs, np.int64)):
        yield rows.slice(start, stop - start)


@dataclass
class LimbStatistics:
    """Statistics of the limbs that a stage has stored.

    Attributes
    ----------
    bases : Counter of str
        The number of limbs for each source of their orientation (`LimbMotion.basis`).
    frames : int
        The number of source frames of the takes.
    jumped : int
        The number of takes that have jumps.
    """

    bases: Counter[str]
    frames: int
    jumped: int


def limb_statistics(store: Store, stage: str) -> LimbStatistics:
    """Return statistics of all limbs that a stage has stored."""
    parts = store.stage_parts(KIND, stage)
    limbs, columns = ["take_id", "limb", "basis"], ["take_id", "limb", "basis", "jump"]
    counted = [rows.group_by(limbs).aggregate(_SUMS) for rows in store.result_pieces(KIND, parts, columns)]
    bases, frames, jumped = Counter[str](), dict[int, int](), set[int]()
    if counted:
        merged = [(f"{name}_{how}", "sum") for name, how in _SUMS]
        for row in pa.concat_tables(counted).group_by(limbs).aggregate(merged).to_pylist():
            bases[row["basis"]] += 1
            frames[row["take_id"]] = max(frames.get(row["take_id"], 0), row["take_id_count_sum"])
            if row["jump_sum_sum"]:
                jumped.add(row["take_id"])
    return LimbStatistics(bases, sum(frames.values()), len(jumped))


def _columns(one: LimbMotion) -> dict[str, pa.Array]:
    frames = len(one.times)
    fit_mm = np.full(frames, np.nan) if one.fit_m is None else 1000.0 * one.fit_m
    return {
        "source_frame": pa.array(np.arange(frames, dtype=np.int32)),
        "t": pa.array(one.times),
        "orientation": struct_array(one.orientation, "wxyz"),
        "position": struct_array(one.position, "xyz"),
        "direction": struct_array(one.direction, "xyz"),
        "valid": pa.array(one.valid),
        "jump": pa.array(one.jump),
        "fit_mm": pa.array(fit_mm, mask=~np.isfinite(fit_mm)),
    }


def struct_array(rows: F64, axes: str) -> pa.Array:
    """Return an array (T, K) as structures with a field for each axis; rows with a NaN are null."""
    lost = ~np.isfinite(rows).all(axis=1)
    parts = [pa.array(np.ascontiguousarray(rows[:, i])) for i in range(len(axes))]
    return pa.StructArray.from_arrays(parts, names=list(axes), mask=pa.array(lost))


def struct_rows(column: pa.ChunkedArray, axes: str) -> F64:
    """Return structures as an array (T, K), with NaN for null."""
    whole = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    fields = [pc.struct_field(whole, axis) for axis in axes]  # null if the structure is null
    return np.stack([field.to_numpy(zero_copy_only=False).astype(np.float64) for field in fields], axis=1)


def stored_limbs(store: Store, stage: str, takes: Iterable[str] | None = None) -> Iterator[StoredLimbs]:
    """Yield the stored limbs of takes, one take at a time.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored them, "<pipeline>/<stage>".
    takes : iterable of str, optional
        Names of the takes to return; by default all takes of the stage.
    """
    wanted = None if takes is None else pa.array(sorted(set(takes)), pa.string())
    parts = store.stage_parts(KIND, stage)
    waiting: list[pa.Table] = []
    for piece in store.result_pieces(KIND, parts):
        rows = piece if wanted is None else piece.filter(pc.is_in(piece.column("take"), wanted))
        for start, stop in _runs(rows.column("take_id").to_numpy()):
            own = rows.slice(start, stop - start)
            if waiting and _take_id(waiting[0]) != _take_id(own):
                yield limbs_of_rows(pa.concat_tables(waiting))
                waiting = []
            waiting.append(own)
    if waiting:
        yield limbs_of_rows(pa.concat_tables(waiting))


def _take_id(rows: pa.Table) -> int:
    return int(rows.column("take_id")[0].as_py())


def _runs(values: I64) -> list[tuple[int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)] if len(values) else []
    return list(pairwise(edges))


def limbs_of_rows(rows: pa.Table) -> StoredLimbs:
    """Return the limbs of a take from all of its rows."""
    names = rows.column("limb").to_pylist()
    first = {name: place for place, name in reversed(list(enumerate(names)))}
    limbs = {}
    for name in sorted(first, key=first.__getitem__):
        limbs[name] = _limb(name, rows.filter(pc.equal(rows.column("limb"), name)))
    return StoredLimbs(_take_id(rows), rows.column("take")[0].as_py(), limbs)


def _limb(name: str, rows: pa.Table) -> LimbMotion:
    fit = rows.column("fit_mm")
    return LimbMotion(
        name,
        rows.column("basis")[0].as_py(),
        rows.column("t").to_numpy(),
        struct_rows(rows.column("orientation"), "wxyz"),
        struct_rows(rows.column("position"), "xyz"),
        struct_rows(rows.column("direction"), "xyz"),
        rows.column("valid").to_numpy().astype(np.bool_),
        rows.column("jump").to_numpy().astype(np.bool_),
        None if fit.null_count == len(fit) else fit.to_numpy() / 1000.0,
    )
