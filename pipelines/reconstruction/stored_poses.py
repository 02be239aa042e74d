"""Build the pose database of a store from the frames of takes, update it, and read it.

Poses are thinned in order of take name and frame: a pose is dropped if an earlier pose that was kept is near, and that
pose then represents its frame. When the database is updated, a kept pose remains unless a new pose that precedes it is
near. Therefore the frames of an unchanged take are read again only if a pose that represents one of its frames is gone,
or if one of its kept poses is near a new pose. The result equals that of a complete build.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.thinned_poses import PoseThinning, bone_directions, bone_lengths_of
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.engine.display import Progress, ProgressBar, no_progress
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.schemas import DEPTH_FORMAT, result_schema
from kinedex.storage.store.store import Store

BATCH_FRAMES = 500_000
"""The approximate number of frames in memory while poses are thinned."""

BONE_DIGITS = 3
"""The number of decimals, in metres, to which mean bones are rounded, so that they do not change with every take."""

_PIECE_ROWS, _PIECE_TAKES = 100_000, 1000


@dataclass(frozen=True)
class TakePoses:
    """A take with its poses in the database.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take : str
        Its name.
    actor : str or None
        Its actor.
    frames : int
        Its length.
    fingerprint : str
        A hash of everything that determines its directions.
    bone_lengths : float64 array (24,) or None
        The median lengths of its bones in metres; None if joints are missing.
    rows : int64 array (K,)
        The frames of the take whose poses are in the database.
    stands_for : int64 array (T,)
        For each frame the number of the near pose that represents it; −1 for frames that have no word or lack a joint.
    directions : float32 array (K, 24, 3)
        The unit directions of bones in its poses.
    """

    take_id: int
    take: str
    actor: str | None
    frames: int
    fingerprint: str
    bone_lengths: F64 | None
    rows: I64 = field(default_factory=lambda: np.empty(0, np.int64))
    stands_for: I64 = field(default_factory=lambda: np.empty(0, np.int64))
    directions: F32 = field(default_factory=lambda: np.empty((0, len(JOINTS), 3), np.float32))


@dataclass(frozen=True)
class PoseDatabase:
    """A pose database.

    Attributes
    ----------
    takes : tuple of TakePoses
        Its takes by name.
    distance_m : float
        The distance by which it was thinned, in metres.
    read : int
        The number of takes whose frames were read to build it.
    """

    takes: tuple[TakePoses, ...]
    distance_m: float
    read: int = 0

    @property
    def mean_bones(self) -> F64:
        """The mean bone lengths of its actors, see `mean_bones`."""
        return mean_bones(self.takes)

    @property
    def directions(self) -> F32:
        """The bone directions of all poses, float32 (N, 24, 3)."""
        return np.concatenate([np.empty((0, len(JOINTS), 3), np.float32), *(one.directions for one in self.takes)])

    @property
    def origins(self) -> list[tuple[str, int]]:
        """The take and the frame of each pose."""
        return [(one.take, int(row)) for one in self.takes for row in one.rows]


def mean_bones(takes: Sequence[TakePoses]) -> F64:
    """Return the mean bone lengths of takes: the mean over actors of the median over the takes of each actor.

    Returns
    -------
    float64 array (24,)
        Lengths in metres, rounded to millimetres; takes without an actor count as those of one actor.

    Raises
    ------
    KinedexError
        No take has all joints.
    """
    actors: dict[str | None, list[F64]] = defaultdict(list)
    for one in takes:
        if one.bone_lengths is not None:
            actors[one.actor].append(one.bone_lengths)
    if not actors:
        raise KinedexError(f"no take has frames with all of the {len(JOINTS)} named joints, which poses are made of")
    ordered = [actors[actor] for actor in sorted(actors, key=lambda name: (name is not None, name or ""))]
    mean: F64 = np.mean([np.median(own, axis=0) for own in ordered], axis=0)
    return np.round(mean, BONE_DIGITS)


def listed_takes(store: Store, where: str, code: str) -> list[TakePoses]:
    """Return the takes that a filter selects, by name, without poses and bones; takes made from depth are excluded.

    Parameters
    ----------
    store : Store
        The store.
    where : str
        A SQL filter over the columns of takes.
    code : str
        A hash of the code that computes directions from frames.

    Raises
    ------
    KinedexError
        The filter does not work, or the store's frames lack named joints.
    """
    if missing := sorted(set(JOINTS).difference(store.feature_set.joints)):
        raise KinedexError(
            f"{store.path}: its feature set {store.feature_set.name} has no joint {', '.join(missing)}, and poses are "
            f"made of all {len(JOINTS)} named joints; ingest the archive with a feature set that lists them"
        )
    chosen = set(store.takes(where)["name"].to_list())
    rows = [row for row in store.take_rows.to_pylist() if row["name"] in chosen and row["format"] != DEPTH_FORMAT]
    return [
        TakePoses(
            row["take_id"], row["name"], row["actor"], row["frames"],
            hash_of(code, row["name"], row["checksum"], row["recipe"], row["frames"], store.rate_hz), None,
        )
        for row in rows
    ]  # fmt: skip


def build_pose_database(
    store: Store,
    takes: Sequence[TakePoses],
    distance_m: float,
    earlier: PoseDatabase | None,
    message: Callable[[str], None],
    progress: Progress = no_progress,
) -> PoseDatabase:
    """Build a pose database from takes, reusing an earlier one where it is still valid.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of TakePoses
        The takes by name, see `listed_takes`.
    distance_m : float
        The distance, in metres, to a kept pose below which a pose is dropped.
    earlier : PoseDatabase or None
        The database before, if there is one.
    message : callable
        Shows a line.
    progress : callable
        Returns a progress bar, given a description and a number of takes.

    Returns
    -------
    PoseDatabase
        The poses; equal to those of a build without an earlier database.

    Raises
    ------
    KinedexError
        No take has all joints.
    """
    before = {one.take: one for one in earlier.takes} if earlier else {}
    same = {one.take for one in takes if one.take in before and before[one.take].fingerprint == one.fingerprint}
    with progress("measuring takes", len(takes) - len(same)) as bar:
        measured = _measure(store, takes, before, same, bar)
    bones = mean_bones(measured)
    if earlier and same:
        reason = ""
        if earlier.distance_m != distance_m:
            reason = f"distance_m was {earlier.distance_m:g}"
        elif not np.array_equal(earlier.mean_bones, bones):
            reason = "the mean bones of the actors have changed, and with them all distances"
        if reason:
            message(f"all takes are thinned anew: {reason}")
            same = set()
    work = _Build(store, PoseThinning(bones, distance_m), PoseThinning(bones, distance_m), before, same)
    made = []
    with progress("comparing poses of takes", len(measured)) as bar:
        for one in work.takes(measured):
            made.append(one)
            bar.advance()
    return PoseDatabase(tuple(made), distance_m, work.read)


def _measure(
    store: Store, takes: Sequence[TakePoses], before: Mapping[str, TakePoses], same: set[str], bar: ProgressBar
) -> list[TakePoses]:
    """Return the takes with their bone lengths; those of unchanged takes are reused."""
    bones = {name: before[name].bone_lengths for name in same}
    for one, poses, _ in _frames(store, [one for one in takes if one.take not in same]):
        bones[one.take] = bone_lengths_of(poses) if len(poses) else None
        bar.advance()
    return [replace(one, bone_lengths=bones[one.take]) for one in takes]


def _frames(store: Store, takes: Sequence[TakePoses]) -> Iterator[tuple[TakePoses, F64, I64]]:
    """Yield takes in order, with joint positions (K, 24, 3) and numbers of the complete frames that have a word."""
    waiting: list[TakePoses] = []
    for index, one in enumerate(takes):
        waiting.append(one)
        if index + 1 == len(takes) or sum(each.frames for each in waiting) >= BATCH_FRAMES:
            tables = dict(store.frames_of([each.take for each in waiting]))
            for each in waiting:
                table = tables.pop(each.take)
                poses = joint_positions(table, JOINTS).transpose(2, 0, 1).astype(np.float64)
                rows = np.flatnonzero(table.column("word").is_valid().to_numpy() & np.isfinite(poses).all(axis=(1, 2)))
                yield each, poses[rows], rows
            waiting = []


class _Build:
    """A build in progress, with the poses kept so far, those of them that are new, and new numbers of former poses."""

    def __init__(
        self, store: Store, kept: PoseThinning, fresh: PoseThinning, before: Mapping[str, TakePoses], same: set[str]
    ) -> None:
        self.store, self.kept, self.fresh, self.before, self.same = store, kept, fresh, before, same
        self.read = 0
        total = sum(len(one.rows) for one in before.values())
        self.number = np.full(total, -1, np.int64)  # former number → new number, −1 if dropped
        starts = np.cumsum([0, *(len(one.rows) for one in before.values())]).tolist()
        self.first = dict(zip(before, starts, strict=False))

    def takes(self, takes: Sequence[TakePoses]) -> Iterator[TakePoses]:
        """Yield the takes with their poses."""
        changed = [one for one in takes if one.take not in self.same]
        frames = _frames(self.store, changed)
        for one in takes:
            if one.take not in self.same:
                _, poses, rows = next(frames)
                yield self._thinned(one, poses, rows)
            elif self._stands(self.before[one.take]):
                yield self._unchanged(one, self.before[one.take])
            else:
                _, poses, rows = next(_frames(self.store, [one]))
                yield self._thinned(one, poses, rows)

    def _stands(self, former: TakePoses) -> bool:
        """Return whether every frame of an unchanged take is kept or dropped as before."""
        own = np.arange(self.first[former.take], self.first[former.take] + len(former.rows))
        others = np.setdiff1d(former.stands_for, [*own, -1])
        gone = len(others) and (self.number[others] < 0).any()
        return not gone and not (self.fresh.near(former.directions) >= 0).any()

    def _unchanged(self, one: TakePoses, former: TakePoses) -> TakePoses:
        first = self.first[former.take]
        self.number[first : first + len(former.rows)] = self.kept.add(former.directions, always=True)
        stands_for = np.where(former.stands_for < 0, -1, self.number[former.stands_for])
        return replace(one, rows=former.rows, stands_for=stands_for, directions=former.directions)

    def _thinned(self, one: TakePoses, poses: F64, frames: I64) -> TakePoses:
        """Return a take after comparing its frames with all poses kept so far."""
        self.read += 1
        directions = bone_directions(poses)
        count = self.kept.count
        numbers = self.kept.add(directions)
        new = numbers >= count
        own, positions = np.unique(numbers[new], return_index=True)
        rows = np.flatnonzero(new)[positions]
        stands_for = np.full(one.frames, -1, np.int64)
        stands_for[frames] = numbers
        former = self.before[one.take] if one.take in self.same else None
        if former is None:
            self.fresh.add(directions[rows], always=True)
        else:
            known = np.isin(frames[rows], former.rows)
            self.fresh.add(directions[rows[~known]], always=True)
            old = self.first[former.take] + np.searchsorted(former.rows, frames[rows[known]])
            self.number[old] = own[known]
        return replace(one, rows=frames[rows], stands_for=stands_for, directions=directions[rows])


def pose_tables(database: PoseDatabase, run: str) -> Iterator[pa.Table]:
    """Yield the poses of a database as rows of the results `poses`."""
    schema = result_schema("poses")
    number = 0
    for some in _batches(database.takes):
        counts = [len(one.rows) for one in some]
        total = sum(counts)
        numbers = np.concatenate([one.directions.reshape(-1) for one in some])
        width = 3 * len(JOINTS)
        yield pa.table(
            {
                "run": pa.repeat(pa.scalar(run), total),
                "pose": np.arange(number, number + total, dtype=np.int32),
                "take_id": np.repeat(np.array([one.take_id for one in some], np.int64), counts),
                "take": pa.array([one.take for one in some]).take(pa.array(np.repeat(np.arange(len(some)), counts))),
                "frame": np.concatenate([one.rows for one in some]).astype(np.int32),
                "directions": pa.ListArray.from_arrays(
                    np.arange(0, total * width + 1, width, dtype=np.int32), pa.array(numbers)
                ),
            },
            schema=schema,
        )
        number += total


def _batches(takes: Sequence[TakePoses]) -> Iterator[list[TakePoses]]:
    """Divide takes into groups of about `_PIECE_ROWS` poses."""
    waiting: list[TakePoses] = []
    for one in takes:
        waiting.append(one)
        if sum(len(each.rows) for each in waiting) >= _PIECE_ROWS:
            yield waiting
            waiting = []
    if waiting:
        yield waiting


def take_tables(database: PoseDatabase, run: str) -> Iterator[pa.Table]:
    """Yield the takes of a database as rows of the results `pose_takes`."""
    schema = result_schema("pose_takes")
    for first in range(0, len(database.takes), _PIECE_TAKES):
        rows = [
            {
                "run": run,
                "take_id": one.take_id,
                "take": one.take,
                "actor": one.actor,
                "frames": one.frames,
                "poses": len(one.rows),
                "distance_m": database.distance_m,
                "bone_lengths": None if one.bone_lengths is None else one.bone_lengths.tolist(),
                "stands_for": pa.array(one.stands_for.astype(np.int32), mask=one.stands_for < 0),
                "fingerprint": one.fingerprint,
            }
            for one in database.takes[first : first + _PIECE_TAKES]
        ]
        yield pa.Table.from_pylist(rows, schema=schema)


def read_pose_database(store: Store, stage: str) -> PoseDatabase | None:
    """Return the pose database of a stage, "<pipeline>/<stage>"; None if there is none or it is incomplete."""
    rows = store.result("pose_takes", stage=stage)
    poses = store.result("poses", stage=stage)
    if not rows.num_rows or sum(rows.column("poses").to_pylist()) != poses.num_rows:
        return None  # repair has removed a damaged part
    directions = poses.column("directions").combine_chunks().flatten().to_numpy(zero_copy_only=False)
    directions = directions.reshape(-1, len(JOINTS), 3)
    frames = poses.column("frame").to_numpy().astype(np.int64)
    takes, start = [], 0
    stands_for = rows.column("stands_for")
    for number, row in enumerate(rows.drop_columns(["stands_for"]).to_pylist()):
        stop = start + row["poses"]
        takes.append(
            TakePoses(
                row["take_id"],
                row["take"],
                row["actor"],
                row["frames"],
                row["fingerprint"],
                None if row["bone_lengths"] is None else np.array(row["bone_lengths"]),
                frames[start:stop],
                stands_for[number].values.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64),
                directions[start:stop],
            )
        )
        start = stop
    return PoseDatabase(tuple(takes), float(rows.column("distance_m")[0].as_py()))
