"""Check pose databases and takes made from depth: compare the rows of poses, frames, votes and errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.snapshot import Snapshot

_UNIT = 1e-4  # tolerance of the lengths of directions, which are float32


def pose_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in the pose databases of a store.

    Poses must be numbered 0, 1, …, and their directions must have length 1 or 0. The number and order of poses must
    agree with the rows of their takes. Every frame that a pose represents must name an existing pose; a frame that is
    itself a pose must name that pose.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    for takes, poses in store.manifest.parts_by_stage("pose_takes", "poses"):
        if not takes:
            yield poses[0].path, f"holds poses of {poses[0].stage}, which has no rows of their takes"
        else:
            yield from _stage_problems(store, poses, takes)


def _stage_problems(
    store: Snapshot, poses: Sequence[ResultPart], takes: Sequence[ResultPart]
) -> Iterator[tuple[str, str]]:
    rows = pa.concat_tables(store.result_pieces("pose_takes", takes))
    counts = rows.column("poses").to_numpy()
    starts = np.concatenate([[0], np.cumsum(counts)])
    names, frames = rows.column("take").to_pylist(), rows.column("stands_for")
    lengths = rows.column("frames").to_numpy()
    seen = 0
    for part in poses:
        for piece in store.result_pieces("poses", [part]):
            problem = _piece_problem(piece, seen)
            if problem is None:
                at = np.arange(seen, seen + piece.num_rows)
                place = np.searchsorted(starts, at, side="right") - 1
                expected = [names[k] if k < len(names) else None for k in place.tolist()]
                if piece.column("take").to_pylist() != expected:
                    problem = "its poses are not those that the rows of their takes count"
            if problem is not None:
                yield part.path, problem
                return
            seen += piece.num_rows
    if seen != starts[-1]:
        yield takes[0].path, f"counts {starts[-1]} poses, and there are {seen}"
        return
    pieces = store.result_pieces("poses", poses)
    frames_of_poses = [piece.column("frame").to_numpy().astype(np.int64) for piece in pieces]
    kept = np.concatenate([np.empty(0, np.int64), *frames_of_poses])
    for k, name in enumerate(names):
        stands_for = frames[k].values.fill_null(-1).to_numpy(zero_copy_only=False)
        own = np.arange(starts[k], starts[k + 1])
        at = kept[starts[k] : starts[k + 1]]
        if len(stands_for) != lengths[k] or np.any(stands_for >= seen) or np.any(at >= lengths[k]):
            yield takes[0].path, f"take {name} names frames or poses that do not exist"
        elif np.any(at < 0) or not np.array_equal(stands_for[at], own):
            yield takes[0].path, f"take {name} has frames that are poses, and others stand for them"


def _piece_problem(piece: pa.Table, first: int) -> str | None:
    """Return the problem of poses whose first number must be `first`; None if there is none."""
    if any(piece.column(name).null_count for name in ("pose", "take", "frame", "directions")):
        return "lacks values"
    if not np.array_equal(piece.column("pose").to_numpy(), np.arange(first, first + piece.num_rows)):
        return f"its poses are not numbered from {first} on"
    column = piece.column("directions").combine_chunks()
    if np.any(column.value_lengths().to_numpy(zero_copy_only=False) != 3 * len(JOINTS)):
        return f"has directions that are not {3 * len(JOINTS)} numbers"
    lengths = np.linalg.norm(column.flatten().to_numpy(zero_copy_only=False).reshape(-1, len(JOINTS), 3), axis=2)
    if not np.all((np.abs(lengths - 1.0) < _UNIT) | (lengths == 0.0)):
        return "has directions whose length is neither 1 nor 0"
    return None


I64 = npt.NDArray[np.int64]

_KINDS = ("reconstructions", "reconstruction_frames", "depth_votes")
_HYPOTHESES, _DIRECTIONS = (None, "local", "database"), ("forward", "backward")
_COST_M = 1e-9  # tolerance in metres between two columns that store the same cost


class _Problem(Exception):
    """A problem, with the path of the part that has it."""


def reconstruction_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in the results of takes made from depth.

    A take must have one row in `reconstructions`, and one row in `reconstruction_frames` for each of its frames. The
    row of a frame must name the hypothesis of least cost, and have joints if it has a hypothesis. A frame with a
    hypothesis must have exactly one winner in `depth_votes`, with the same hypothesis, direction, cost and origin.
    Errors must be valid fractions and distances, for as many frames as their take has. The frames of archive takes that
    votes name are not checked, since these takes may have been replaced.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    for parts in store.manifest.parts_by_stage(*_KINDS):
        try:
            _check_stage(store, parts)
        except _Problem as found:
            yield found.args
    for (own,) in store.manifest.parts_by_stage("reconstruction_errors"):
        problem = _errors_problem(pa.concat_tables(store.result_pieces("reconstruction_errors", own)))
        if problem:
            yield own[0].path, problem


@dataclass(frozen=True, eq=False)
class _Rows:
    """Columns of one kind of results of a stage, sorted by take and frame, with the part of each row."""

    parts: Sequence[ResultPart]
    part: I64
    columns: dict[str, npt.NDArray[Any]]

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self.columns[name]

    def problem(self, row: int, text: str) -> _Problem:
        """Return the problem of a row as an exception."""
        take = self.columns["take"][row]
        frame = f", frame {self.columns['source_frame'][row]}" if "source_frame" in self.columns else ""
        return _Problem(self.parts[int(self.part[row])].path, f"take {take}{frame} {text}")

    def where(self, chosen: npt.NDArray[np.bool_]) -> _Rows:
        """Return the rows at which a mask is True."""
        return _Rows(self.parts, self.part[chosen], {name: values[chosen] for name, values in self.columns.items()})

    def check(self, wrong: npt.NDArray[np.bool_], text: str) -> None:
        """Raise a problem for the first row at which a mask is True."""
        rows = np.flatnonzero(wrong)
        if len(rows):
            raise self.problem(int(rows[0]), text)


def _rows(store: Snapshot, kind: str, parts: Sequence[ResultPart], names: Sequence[str], order: Sequence[str]) -> _Rows:
    """Read columns of results; texts become object arrays, and missing numbers become NaN or −1."""
    pieces, numbers = [], []
    for number, part in enumerate(parts):
        for piece in store.result_pieces(kind, [part]):
            if "joints" in names:
                _check_joints(part, piece)
                piece = piece.set_column(
                    piece.schema.get_field_index("joints"), "joints", pc.is_valid(piece.column("joints"))
                )
            pieces.append(piece.select(list(names)))
            numbers.append(np.full(piece.num_rows, number))
    found = {name: np.empty(0, np.int64) for name in names}
    if pieces:
        table = pa.concat_tables(pieces)
        found = {name: _values(table.column(name)) for name in names}
    part_of = np.concatenate([np.empty(0, np.int64), *numbers])
    by = np.lexsort([found[name] for name in reversed(order)])
    return _Rows(parts, part_of[by], {name: values[by] for name, values in found.items()})


def _values(column: pa.ChunkedArray) -> npt.NDArray[Any]:
    if pa.types.is_integer(column.type):
        return np.asarray(column.fill_null(-1).to_numpy(), np.int64)
    return np.asarray(column.to_numpy())


def _check_joints(part: ResultPart, piece: pa.Table) -> None:
    joints = pc.drop_null(piece.column("joints").combine_chunks())
    lengths = joints.value_lengths().to_numpy(zero_copy_only=False)
    values = joints.flatten().to_numpy(zero_copy_only=False)
    if np.any(lengths != 3 * len(JOINTS)) or not np.isfinite(values).all():
        raise _Problem(part.path, f"has joints that are not {3 * len(JOINTS)} numbers")


def _check_stage(store: Snapshot, parts: Sequence[Sequence[ResultPart]]) -> None:
    """Raise the first problem of the results of a stage."""
    key, frame = ("take_id", "take"), ("take_id", "source_frame")
    own = ("hypothesis", "direction", "archive_take", "archive_frame")
    takes = _rows(store, _KINDS[0], parts[0], (*key, "source_frames", "unseen_frames"), ("take_id",))
    costs = ("cost_local", "cost_database", "joints")
    frames = _rows(store, _KINDS[1], parts[1], (*key, "source_frame", *own, *costs), frame)
    votes = _rows(store, _KINDS[2], parts[2], (*key, "source_frame", *own, "candidate", "cost", "winner"), frame)
    takes.check(np.diff(takes["take_id"], prepend=-1) == 0, "has two rows")
    _check_takes(takes, frames)
    for rows in (frames, votes):
        rows.check(
            _given(rows["archive_take"]) != (rows["archive_frame"] >= 0),
            "names an archive take without a frame, or a frame without a take",
        )
    _check_votes(frames, votes)


def _check_takes(takes: _Rows, frames: _Rows) -> None:
    """Check that each take has all of its frames, and that the values of each frame are consistent."""
    ids, starts, counts = np.unique(frames["take_id"], return_index=True, return_counts=True)
    place = np.searchsorted(takes["take_id"], ids)
    known = (place < len(takes["take_id"])) & (
        np.append(takes["take_id"], -1)[np.minimum(place, len(takes["take_id"]))] == ids
    )
    if not known.all():
        raise frames.problem(int(starts[~known][0]), "has no row in `reconstructions`")
    takes.check(~np.isin(takes["take_id"], ids), "has no rows in `reconstruction_frames`")
    expected = np.arange(len(frames["source_frame"])) - np.repeat(starts, counts)
    frames.check(frames["source_frame"] != expected, "is there twice, or the one before it is missing")
    takes.check(takes["source_frames"] != counts, "has more or fewer frames than it counts")
    seen = frames["joints"].astype(np.bool_)
    unseen = np.add.reduceat(~seen, starts) if len(starts) else np.empty(0)
    takes.check(takes["unseen_frames"] != unseen, "has more or fewer frames without a pose than it counts")
    hypothesis = frames["hypothesis"]
    frames.check(~np.isin(hypothesis.astype(str), [str(one) for one in _HYPOTHESES]), "has no such hypothesis")
    frames.check(~np.isin(frames["direction"].astype(str), _DIRECTIONS), "has no such direction")
    frames.check(seen != _given(hypothesis), "has joints without a hypothesis, or one without joints")
    local, database = frames["cost_local"].astype(np.float64), frames["cost_database"].astype(np.float64)
    lent = np.equal(hypothesis, "database")
    cheaper = np.where(lent, ~(local <= database), ~(database < local))
    costs = np.where(lent, database, local)
    frames.check(seen & ~(cheaper & np.isfinite(costs)), "has a hypothesis that does not cost least")
    frames.check(lent & (frames["archive_frame"] < 0), "has a pose of the archive without its origin")


def _check_votes(frames: _Rows, votes: _Rows) -> None:
    """Check that each frame with a pose has exactly one winning vote, which agrees with the frame."""
    won = votes.where(votes["winner"].astype(np.bool_))
    posed = frames.where(frames["joints"].astype(np.bool_))
    shared = min(len(won.part), len(posed.part))
    same = (won["take_id"][:shared] == posed["take_id"][:shared]) & (
        won["source_frame"][:shared] == posed["source_frame"][:shared]
    )
    if len(won.part) != len(posed.part) or not same.all():
        first = int(np.append(np.flatnonzero(~same), shared)[0])
        rows = won if first < len(won.part) else posed
        raise rows.problem(first, "has no winner among its votes, or more than one, or one without a pose")
    lent = np.equal(posed["hypothesis"], "database")
    costs = np.where(lent, posed["cost_database"].astype(np.float64), posed["cost_local"].astype(np.float64))
    for name in ("hypothesis", "direction"):
        won.check(np.not_equal(won[name], posed[name]), f"has a winner of another {name} than the frame")
    won.check(
        ~(np.abs(won["cost"].astype(np.float64) - costs) < _COST_M), "has a winner of another cost than the frame"
    )
    for name in ("archive_take", "archive_frame"):
        won.check(lent & np.not_equal(won[name], posed[name]), "has a winner of another origin than the frame")
    numbered = np.equal(votes["hypothesis"], "database") == (votes["candidate"] > 0)
    votes.check(~numbered, "has a candidate without a number, or a number that is no candidate's")


def _given(values: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Return a mask of the texts that are not NULL."""
    return np.array([one is not None for one in values.tolist()], np.bool_)


def _errors_problem(rows: pa.Table) -> str:
    """Return the problem of rows of `reconstruction_errors`; empty if there is none."""
    found = rows.to_pylist()
    takes = {row["take_id"]: row for row in found if row["scope"] == "take"}
    whole = sum(row["frames"] for row in found if row["scope"] == "all")
    for row in found:
        name = f"{row['take'] or 'all'}, {row['scope']} {row['name']}"
        if row["scope"] not in ("all", "take", "joint"):
            return f"{name}: no such scope"
        shares = [row[key] for key in ("over_10cm", "rate_five_ends") if row[key] is not None]
        sizes = [row[key] for key in ("mean_m", "std_m", "median_m", "p90_m") if row[key] is not None]
        if not all(0 <= share <= 1 for share in shares) or not all(size >= 0 for size in sizes):
            return f"{name}: has a share beyond 0 and 1, or a distance below 0"
        if row["scope"] == "joint" and row["frames"] > takes.get(row["take_id"], {"frames": -1})["frames"]:
            return f"{name}: has more frames than its take"
    if whole != sum(row["frames"] for row in takes.values()):
        return "all takes have more or fewer frames than each of them together"
    return ""
