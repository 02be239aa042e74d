"""Find takes with the same file or the same motion, even if it is cut, moved, turned, mirrored, or at another rate."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa
import xxhash

from kinedex.ops.arrays import F32, I64
from kinedex.ops.cache import Cache
from kinedex.ops.duplicates.alignments import find_alignments, plausible
from kinedex.ops.duplicates.poses import TakePoses
from kinedex.ops.duplicates.same_motion import AROUND, NEARLY_ALL, SameMotion, changes_of, is_supported, same_motion
from kinedex.ops.intervals import in_seconds
from kinedex.ops.search.runs import word_runs
from kinedex.ops.wording import counted
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.pipelines.engine.display import Display, Progress, no_progress
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.writer import StoreWriter

STAGE = "duplicates/find"
"""The stage under whose name the rows are stored."""

HELD_BYTES = 512 * 2**20
"""The size of a block of takes in bytes, which its last take may exceed; two blocks are held in memory at a time."""

CACHED_BYTES = 256 * 2**20
"""The largest size, in bytes, of the cache of poses."""

Candidate = tuple[int, int, int, bool, int, int]
"""A possible alignment of two takes: both numbers, the shift in frames, whether the second is mirrored, and the frames
of the second that support it."""


def find_duplicates(store: Snapshot, display: Display) -> pa.Table:
    """Find the takes that contain the same file or the same motion as another take.

    Takes with one checksum and the same words are copies of a file. Only one take of each file is compared with other
    takes: equal sequences of runs yield alignments (`ops.duplicates.alignments`), and the joint positions decide
    (`ops.duplicates.same_motion`).

    Parameters
    ----------
    store : Snapshot
        The version of the store to search.
    display : Display
        Shows progress.

    Returns
    -------
    pyarrow.Table
        The rows of the view `duplicates`, without `run`: sorted by both names. A row refers a take to a longer take
        with the same motion, or to one of the same length whose name comes first; so one take of a group has no row.
    """
    rows, kept = _same_files(store)
    rows += _same_motions(store, kept, display.progress)
    rates = dict(
        zip(*(store.take_columns(one).column(0).to_pylist() for one in ("name", "source_rate_hz")), strict=True)
    )
    for row in rows:
        if row["same"] == "motion" and rates[row["take"]] != rates[row["of_take"]]:
            row["changes"].append("resampled")
        row["changes"] = ", ".join(row["changes"]) or ("same file" if row["same"] == "file" else "same frames")
    rows.sort(key=lambda row: (row["take"], row["of_take"], row["start"]))
    schema = result_schema("duplicates")
    return pa.Table.from_pylist(rows, schema=schema.remove(schema.get_field_index("run")))


def hold_one_motion(store: Snapshot, names: Sequence[str]) -> bool:
    """Return whether takes contain the same motion from start to end, so that a label of one applies to each of them.

    Parameters
    ----------
    store : Snapshot
        The version of their store.
    names : sequence of str
        The names of the takes; a single one gives True.
    """
    if len(names) < 2:
        return True
    lengths = [store.take_frames[store.take_id(name)] for name in names]
    if min(lengths) < NEARLY_ALL * max(lengths):
        return False
    rows = _same_motions(store, list(names), no_progress)
    whole = [
        row
        for row in rows
        if row["share"] >= NEARLY_ALL and not row["mirrored"] and abs(row["shift_seconds"]) * store.rate_hz <= 1.0
    ]
    return len({(row["take"], row["of_take"]) for row in whole}) == len(names) * (len(names) - 1) // 2


def save_duplicates(store: Snapshot, table: pa.Table, run: str) -> None:
    """Store the duplicates as results, replacing earlier ones.

    Raises
    ------
    StoreError
        If another process writes to the store.
    """
    with StoreWriter.open(store.path, store.feature_set, store.rate_hz) as writer:
        writer.put_results("duplicates", table, stage=STAGE, run=run)
        writer.commit()


def copies_line(store: Snapshot) -> str | None:
    """Return a line that counts the takes whose file is a copy of another take's; None if there are none."""
    rows, _ = _same_files(store)
    if not rows:
        return None
    first, verb = rows[0], "comes" if len(rows) == 1 else "come"
    return (
        f"{counted(len(rows), 'take')} of {len(store.take_ids):,} {verb} from a copy of another take's file: "
        f"'{first['take']}' (as '{first['of_take']}'){', …' if len(rows) > 1 else ''}; "
        f"`kinedex duplicates {shlex.quote(str(store.path))}` also compares motion"
    )


def _same_files(store: Snapshot) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the rows of takes whose file is a copy, and the names of all other takes."""
    several = ("person",) if "person" in store.manifest.takes_schema.names else ()
    rows = store.take_columns("name", "take_id", "checksum", *several)
    persons = rows.column("person").to_pylist() if several else [None] * rows.num_rows
    columns = (rows.column(name).to_pylist() for name in ("name", "take_id", "checksum"))
    facts = list(zip(*columns, persons, strict=True))
    files = Counter((checksum, person) for _, _, checksum, person in facts)
    words = store.words([take_id for _, take_id, *file in facts if files[tuple(file)] > 1])
    read = {int(take_id): xxhash.xxh3_128_digest(words.take(i).tobytes()) for i, take_id in enumerate(words.take_ids)}
    first: dict[tuple[Any, ...], str] = {}
    found: list[dict[str, Any]] = []
    for name, take_id, *file in facts:
        other = first.setdefault((*file, read.get(take_id)), name)
        if other != name:
            count = store.take_frames[store.take_id(name)]
            found.append(_row(store, name, other, "file", SameMotion(0, count, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)))
    return found, list(first.values())


def _same_motions(store: Snapshot, names: list[str], progress: Progress) -> list[dict[str, Any]]:
    """Return the rows of pairs among the given takes that contain the same motion."""
    words = store.words([store.take_id(name) for name in names])
    ordered = [store.take_names[take_id] for take_id in words.take_ids.tolist()]
    found = _candidates(store, words, progress)
    poses = _Poses(store)
    best: dict[tuple[str, str, bool], dict[str, Any]] = {}
    with progress("comparing takes", len(found)) as bar:
        for group in _blocks(found, words.frames * len(store.feature_set.joints) * 12):
            poses.hold({ordered[take] for candidate in group for take in candidate[:2]})
            for one, two, shift, image, start, stop in group:
                row = _common(store, poses, ordered[one], ordered[two], shift, image, start, stop)
                bar.advance()
                if row is not None:
                    key = (row["take"], row["of_take"], row["mirrored"])
                    if key not in best or row["stop"] - row["start"] > best[key]["stop"] - best[key]["start"]:
                        best[key] = row
    return list(best.values())


def _candidates(store: Snapshot, words: TakeWords, progress: Progress) -> list[Candidate]:
    """Return possible alignments of the same motion according to the words, in order of the takes."""
    mirrored = store.feature_set.mirrored if store.feature_set.mirror else lambda _: None
    steady = np.where(words.words == NO_WORD, NO_WORD, words.words & np.uint64(store.feature_set.steady))
    images = mirrored(steady)
    found: dict[tuple[int, int, int, bool], tuple[int, int]] = {}
    with progress("comparing words", 2 * len(words)) as bar:
        for sought in (words.words, steady):
            runs, done = word_runs(sought, words.offsets), 0
            for block in find_alignments(runs, mirrored(runs.word)):
                kept = plausible(steady, words.offsets, images, block, store.rate_hz)
                one, two, shift, image, _, start, stop = (column[kept].tolist() for column in block)
                found.update(zip(zip(one, two, shift, image, strict=True), zip(start, stop, strict=True), strict=True))
                bar.advance(int(block.first[-1]) - done)
                done = int(block.first[-1])
    return [(*alignment, *support) for alignment, support in sorted(found.items())]


def _blocks(found: Sequence[Candidate], sizes: I64) -> Iterator[list[Candidate]]:
    """Yield groups of alignments, each between two blocks of takes; each block holds some `HELD_BYTES` of poses."""
    number = ((np.cumsum(sizes) - sizes) // HELD_BYTES).tolist()

    def blocks(one: Candidate) -> tuple[int, int]:
        return number[one[0]], number[one[1]]

    for _, group in groupby(sorted(found, key=blocks), key=blocks):
        yield list(group)


def _common(
    store: Snapshot, poses: _Poses, one: str, two: str, shift: int, image: bool, start: int, stop: int
) -> dict[str, Any] | None:
    """Return the row of two takes at an alignment; None if their motion differs."""
    frames = store.take_frames
    lengths = {name: frames[store.take_id(name)] for name in (one, two)}
    other, take = sorted((one, two), key=lambda name: (-lengths[name], name))
    near, support = (shift, (start, stop)) if other == one else (-shift, (start + shift, stop + shift))
    first, second = poses.of(other, False), poses.of(take, image)
    match, body = same_motion(first.own, second.own, near, store.rate_hz, support), False
    if match is None and not first.is_on_body_of(second) and _alike_on_one_body(first, second, near, support):
        match, body = same_motion(first.on_ordinary_body, second.on_ordinary_body, near, store.rate_hz), True
    if match is None:
        return None
    return _row(store, take, other, "motion", match, image, body)


def _alike_on_one_body(first: TakePoses, second: TakePoses, shift: int, support: tuple[int, int]) -> bool:
    """Return whether poses at the support of an alignment are near on a body of ordinary size."""
    low, high = max(0, support[0] - AROUND), support[1] + AROUND
    begin = max(0, low + shift - AROUND)
    one = first.part_on_ordinary_body(begin, high + shift + AROUND)
    other = second.part_on_ordinary_body(low, high)
    return bool(is_supported(one, other, shift + low - begin, support[0] - low, support[1] - low))


def _row(
    store: Snapshot, take: str, other: str, same: str, match: SameMotion, image: bool = False, body: bool = False
) -> dict[str, Any]:
    """Return a row of the view `duplicates`."""
    start, stop = match.start, match.stop
    frames, others = (store.take_frames[store.take_id(name)] for name in (take, other))
    changes = changes_of(match, frames, others)
    changes += ["mirrored"] * image + ["another body"] * body
    return {
        "take_id": store.take_id(take), "take": take, "of_take_id": store.take_id(other), "of_take": other,
        "same": same, "changes": changes, "start": start, "stop": stop,
        "start_seconds": in_seconds(start, store.rate_hz), "stop_seconds": in_seconds(stop, store.rate_hz),
        "share": (stop - start) / frames, "shift_seconds": in_seconds(match.shift, store.rate_hz),
        "pace": match.pace, "mirrored": image, "distance_mm": 1000.0 * match.distance_m,
    }  # fmt: skip


class _Poses:
    """The poses of takes: the joint positions of some takes are held in memory, and recently used poses are cached."""

    def __init__(self, store: Snapshot) -> None:
        self._store = store
        self._joints = list(store.feature_set.joints)
        self._held: dict[str, F32] = {}
        self._cached: Cache[tuple[str, bool], TakePoses] = Cache(CACHED_BYTES, lambda poses: poses.nbytes, least=2)

    def hold(self, takes: set[str]) -> None:
        """Hold the joint positions of the given takes in memory, and free all others."""
        self._held = {take: positions for take, positions in self._held.items() if take in takes}
        for take, frames in self._store.frames_of(takes - self._held.keys()):
            self._held[take] = np.ascontiguousarray(joint_positions(frames, self._joints).transpose(2, 0, 1))

    def of(self, take: str, mirrored: bool) -> TakePoses:
        """Return the poses of a take held in memory, or of its mirror image."""
        kept = self._cached.get((take, mirrored))
        if kept is None:
            kept = self._cached.put((take, mirrored), TakePoses(self._held[take], self._joints, mirrored))
        return kept
