"""Assign segments of label files to the takes of a store, and find the differences between two lists of segments."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.evaluation.detection import overlap
from kinedex.ops.intervals import analysis_frame
from kinedex.ops.wording import name_list
from kinedex.pipelines.ingestion.known_files import file_names, person_name
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, unmatched_labels
from kinedex.storage.formats.labels.file_labels import ERROR, LabelFile, ManualSegment
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store

Change = Literal["same", "moved", "renamed", "added", "removed"]


def segment_of(row: Mapping[str, Any]) -> ManualSegment:
    """Return a row of annotations or labels as a segment in analysis frames."""
    limb, annotator = row.get("limb") or "", row.get("annotator") or ""
    return ManualSegment(row["take"], row["class"], row["start"], row["stop"], limb=limb, annotator=annotator)


@dataclass(frozen=True)
class SegmentDifference:
    """A segment before and after a change; an added segment has no `before`, a removed one no `after`."""

    change: Change
    before: ManualSegment | None
    after: ManualSegment | None

    @property
    def shown(self) -> ManualSegment:
        """The segment after the change, or the removed one."""
        found = self.after or self.before
        assert found is not None
        return found


@dataclass(frozen=True)
class PlacedFiles:
    """The segments of label files, assigned to the takes of a store.

    Attributes
    ----------
    takes : tuple of str
        The takes of the store that the files name, including those without a segment.
    segments : tuple of ManualSegment
        The distinct segments, in analysis frames.
    covered : tuple of ManualSegment
        Whole takes in which an annotator has examined a limb, or all limbs, without marking an error.
    remarks : tuple of str
        Remarks on takes and segments that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, file by file.
    """

    takes: tuple[str, ...]
    segments: tuple[ManualSegment, ...]
    covered: tuple[ManualSegment, ...]
    remarks: tuple[str, ...]
    unmatched: tuple[UnmatchedLabels, ...] = ()


def placed_files(store: Store, files: Sequence[LabelFile]) -> PlacedFiles:
    """Assign the segments of label files to the takes of a store, in analysis frames.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    files : sequence of LabelFile
        The files.

    Raises
    ------
    SourceError
        A segment ends beyond its take.
    KinedexError
        The store has none of the takes.
    """
    columns = ("name", "source_frames", "source_rate_hz", "rate_hz", "frames")
    rows = {str(row["name"]): row for row in store.takes().select(columns).iter_rows(named=True)}
    files, remarks = with_take_names(store, files)
    named = dict.fromkeys(take for file in files for take in file.takes)
    absent = sorted(set(named) - set(rows))
    if absent and len(absent) == len(named):
        raise KinedexError(
            f"none of the takes of these files is in {store.path}: no take is named '{absent[0]}'"
            f"{did_you_mean(absent[0], rows)}"
        )
    unmatched = unmatched_labels(files, rows)
    remarks += map(str, unmatched)
    found: dict[tuple[object, ...], ManualSegment] = {}
    for one in (segment for file in files for segment in file.segments if segment.take in rows):
        (_, start), (_, stop) = edges_in(one, rows[one.take])
        if start >= stop:
            remarks.append(f"{one.where}: no analysis frame lies in this segment, excluded")
            continue
        placed = replace(one, start=start, stop=stop, in_seconds=False)
        found.setdefault((one.take, one.label, start, stop, one.limb, one.annotator), placed)
    covered = [
        ManualSegment(take, ERROR, 0, rows[take]["frames"], path, limb=limb, annotator=annotator)
        for path, take, limb, annotator in _covered(files)
        if take in rows and rows[take]["frames"]
    ]
    takes = tuple(take for take in named if take in rows)
    return PlacedFiles(takes, tuple(found.values()), tuple(covered), tuple(remarks), unmatched)


def edges_in(one: ManualSegment, take: Mapping[str, Any]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return start and stop of a segment, each in source frames and in analysis frames of its take.

    Raises
    ------
    SourceError
        The segment ends beyond its take.
    """
    first, last = one.source_frames(take["source_rate_hz"])
    if last > take["source_frames"]:
        frames = take["source_frames"]
        raise one.error(f"stop {last} is beyond the end of {one.take}, which has {frames} source frames")
    start, stop = (analysis_frame(edge, take["source_rate_hz"], take["rate_hz"]) for edge in (first, last))
    return (first, start), (last, stop)


def _covered(files: Iterable[LabelFile]) -> Iterator[tuple[str, str, str, str]]:
    """Yield path, take, limb and annotator for limbs that were examined without an error being marked."""
    for file in files:
        for take, limb, annotator in file.covered:
            yield file.path, take, limb, annotator
        own = {(one.annotator, one.take) for one in file.segments if one.label == ERROR}
        own |= {(annotator, take) for take, _, annotator in file.covered}
        for annotator, takes in file.looked_at.items():
            yield from ((file.path, take, "", annotator) for take in sorted(takes) if (annotator, take) not in own)


def segment_differences(
    before: Iterable[ManualSegment], after: Iterable[ManualSegment], tolerance: float = 0.0
) -> list[SegmentDifference]:
    """Compare two lists of segments take by take; segments about limbs are compared by limb and person.

    Segments are paired in three steps. Segments with the same class, start and stop are equal. Of the others, segments
    with the same start and stop but another class are renamed. Then, overlapping segments of a class are moved, pairs
    with the largest overlap first. The remaining segments were removed or added.

    Parameters
    ----------
    before, after : iterable of ManualSegment
        The lists.
    tolerance : float, optional
        The largest difference of starts or stops that count as equal.

    Returns
    -------
    list of SegmentDifference
        The differences, sorted by take and start.
    """
    groups: dict[tuple[str, str, str], tuple[list[ManualSegment], list[ManualSegment]]] = defaultdict(lambda: ([], []))
    for place, segments in enumerate((before, after)):
        for one in segments:
            groups[one.take, one.limb, one.annotator if one.limb else ""][place].append(one)

    def order(one: SegmentDifference) -> tuple[str, float, float, str, str, str]:
        shown = one.shown
        return shown.take, shown.start, shown.stop, shown.label, shown.limb, shown.annotator

    return sorted((one for old, new in groups.values() for one in _of_group(old, new, tolerance)), key=order)


def _of_group(before: list[ManualSegment], after: list[ManualSegment], tolerance: float) -> list[SegmentDifference]:
    found: list[SegmentDifference] = []

    def pair(change: Change, old: ManualSegment, new: ManualSegment) -> None:
        found.append(SegmentDifference(change, old, new))
        before.remove(old)
        after.remove(new)

    def equal(one: ManualSegment, other: ManualSegment) -> bool:
        return abs(one.start - other.start) <= tolerance and abs(one.stop - other.stop) <= tolerance

    changes: tuple[tuple[Change, bool], ...] = (("same", True), ("renamed", False))
    for change, same_class in changes:
        for old in sorted(before, key=lambda one: (one.start, one.stop)):
            fitting = (new for new in after if (new.label == old.label) == same_class and equal(old, new))
            if (match := next(fitting, None)) is not None:
                pair(change, old, match)
    pairs = [
        (overlap((old.start, old.stop), (new.start, new.stop)), old, new)
        for old in before
        for new in after
        if old.label == new.label
    ]
    for share, old, new in sorted(pairs, key=lambda one: (-one[0], one[1].start, one[2].start)):
        if share > 0 and old in before and new in after:
            pair("moved", old, new)
    return [
        *found,
        *(SegmentDifference("removed", one, None) for one in before),
        *(SegmentDifference("added", None, one) for one in after),
    ]


def with_take_names(store: Snapshot, files: Sequence[LabelFile]) -> tuple[list[LabelFile], list[str]]:
    """Replace names of files, which label files may give instead of names of takes, by the names of their takes.

    If files have equal stems, their takes are named by paths, and a label file that gives the stem matches several
    takes. Its labels are assigned to each of them if all contain the same motion.

    Parameters
    ----------
    store : Snapshot
        The store.
    files : sequence of LabelFile
        The label files.

    Returns
    -------
    files : list of LabelFile
        The files with the names of takes.
    remarks : list of str
        Remarks on names that stand for several takes, on names of a take that match the files of other takes as well,
        and on names that match takes with different motion, which are not replaced.
    """
    columns = ["name", "source", "format", "checksum", "person"]
    rows = store.take_rows.select([one for one in columns if one in store.take_rows.column_names]).to_pylist()
    named = {take for file in files for take in file.takes}
    exact = named & {str(row["name"]) for row in rows}
    fitting: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in (row for row in rows if row["format"] not in RECORDED_FORMATS):
        names = {person_name(name, row.get("person") or "") for name in file_names("stem", str(row["source"]))}
        for name in names & named:
            fitting[name].append(row)
    others = {name: [row for row in fitting.pop(name, []) if row["name"] != name] for name in exact}
    same = {name for name, found in fitting.items() if _hold_one_motion(store, found)}
    chosen = {name: [str(row["name"]) for row in found] for name, found in fitting.items() if name in same}
    remarks = [
        f"labels of '{name}' belong to {name_list(takes)}, which hold the same motion"
        for name, takes in chosen.items()
        if len(takes) > 1
    ]
    remarks += [
        f"labels of '{name}' belong to the take of this name alone, not to {_takes(found)}, whose files are named so"
        for name, found in sorted(others.items())
        if found
    ]
    remarks += [
        f"'{name}' fits takes of different motion, {_takes(found)}: labels of it belong to "
        "none of them until the file names one of these"
        for name, found in fitting.items()
        if name not in same
    ]
    return [_renamed(file, chosen) for file in files], remarks


def _takes(rows: Iterable[dict[str, Any]]) -> str:
    return name_list([str(row["name"]) for row in rows])


def _hold_one_motion(store: Snapshot, rows: Sequence[dict[str, Any]]) -> bool:
    """Return whether all takes contain the same motion.

    Of takes with the same file content (and the same person), only one is compared with the others.
    """
    from kinedex.pipelines.inspection.duplicates import hold_one_motion

    by_file: dict[tuple[str, str | None], str] = {}
    for row in rows:
        by_file.setdefault((row["checksum"], row.get("person")), str(row["name"]))
    return hold_one_motion(store, list(by_file.values()))


def _renamed(file: LabelFile, chosen: dict[str, list[str]]) -> LabelFile:
    """Return a label file with names of takes; labels of several takes are repeated for each take."""
    if not chosen.keys() & set(file.takes):
        return file

    def names(take: str) -> list[str]:
        return chosen.get(take, [take])

    return replace(
        file,
        takes=tuple(dict.fromkeys(name for take in file.takes for name in names(take))),
        segments=tuple(replace(one, take=name) for one in file.segments for name in names(one.take)),
        covered=tuple((name, limb, by) for take, limb, by in file.covered for name in names(take)),
    )
