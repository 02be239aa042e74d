"""Assign segments of label files to the takes of a store, and find the differences between two lists of segments."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.evaluation.ground_truth import analysis_frame
from kinedex.pipelines.labels.label_takes import on_takes
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, unmatched_labels
from kinedex.storage.formats.labels.segments import ERROR, LabelFile
from kinedex.storage.store.store import Store

Change = Literal["same", "moved", "renamed", "added", "removed"]


@dataclass(frozen=True)
class Segment:
    """A class in an interval [start, stop) of a take, in frames or seconds, and its place in a file."""

    take: str
    label: str
    start: float
    stop: float
    where: str = ""
    limb: str = ""
    annotator: str = ""

    @property
    def about(self) -> tuple[str, str, str]:
        """The take and, for a label of a limb, limb and annotator; only segments that agree in it are compared."""
        return self.take, self.limb, self.annotator if self.limb else ""


@dataclass(frozen=True)
class Difference:
    """A segment before and after a change; an added segment has no `before`, a removed one no `after`."""

    change: Change
    before: Segment | None
    after: Segment | None


@dataclass(frozen=True)
class PlacedFiles:
    """The segments of label files, assigned to the takes of a store.

    Attributes
    ----------
    takes : tuple of str
        The takes of the store that the files name, including those without a segment.
    segments : tuple of Segment
        The distinct segments, in analysis frames.
    covered : tuple of Segment
        Whole takes in which an annotator has examined a limb, or all limbs, without marking an error.
    remarks : tuple of str
        Takes and segments that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, file by file.
    """

    takes: tuple[str, ...]
    segments: tuple[Segment, ...]
    covered: tuple[Segment, ...]
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
    rows = {str(row[0]): row[1:] for row in store.takes().select(columns).iter_rows()}
    files, remarks = on_takes(store, files)
    named = dict.fromkeys(take for file in files for take in file.takes)
    absent = sorted(set(named) - set(rows))
    if absent and len(absent) == len(named):
        raise KinedexError(
            f"none of the takes of these files is in {store.path}: no take is named '{absent[0]}'"
            f"{did_you_mean(absent[0], rows)}"
        )
    unmatched = unmatched_labels(files, rows)
    remarks += map(str, unmatched)
    found: dict[Segment, Segment] = {}
    for one in (segment for file in files for segment in file.segments if segment.take in rows):
        frames, source_rate_hz, rate_hz, _ = rows[one.take]
        first, last = one.source_frames(source_rate_hz)
        if last > frames:
            raise one.error(f"stop {last} is beyond the end of {one.take}, which has {frames} source frames")
        start, stop = (analysis_frame(edge, source_rate_hz, rate_hz) for edge in (first, last))
        if start >= stop:
            remarks.append(f"{one.where}: no analysis frame lies in this segment, excluded")
            continue
        placed = Segment(one.take, one.label, start, stop, "", one.limb, one.annotator)
        found.setdefault(placed, replace(placed, where=one.where))
    covered = [
        Segment(take, ERROR, 0, rows[take][3], path, limb, annotator)
        for path, take, limb, annotator in _covered(files)
        if take in rows and rows[take][3]
    ]
    takes = tuple(take for take in named if take in rows)
    return PlacedFiles(takes, tuple(found.values()), tuple(covered), tuple(remarks), unmatched)


def _covered(files: Iterable[LabelFile]) -> Iterator[tuple[str, str, str, str]]:
    """Yield path, take, limb and annotator for limbs that were examined without an error being marked."""
    for file in files:
        for take, limb, annotator in file.covered:
            yield file.path, take, limb, annotator
        own = {(one.annotator, one.take) for one in file.segments if one.label == ERROR}
        own |= {(annotator, take) for take, _, annotator in file.covered}
        for annotator, takes in file.looked_at.items():
            yield from ((file.path, take, "", annotator) for take in sorted(takes) if (annotator, take) not in own)


def differences(before: Iterable[Segment], after: Iterable[Segment], tolerance: float = 0.0) -> list[Difference]:
    """Compare two lists of segments take by take; segments about limbs are compared by limb and person.

    Segments with the same class, start and stop are equal; then those with the same start and stop but another class
    are renamed; then those of a class that overlap are moved, pairs with the largest overlap first. The remaining ones
    were removed or added.

    Parameters
    ----------
    before, after : iterable of Segment
        The lists.
    tolerance : float, optional
        Starts or stops that differ by at most this are equal.

    Returns
    -------
    list of Difference
        The differences, sorted by take and start.
    """
    groups: dict[tuple[str, str, str], tuple[list[Segment], list[Segment]]] = defaultdict(lambda: ([], []))
    for place, segments in enumerate((before, after)):
        for one in segments:
            groups[one.about][place].append(one)
    found = [one for old, new in groups.values() for one in _of_group(old, new, tolerance)]
    return sorted(found, key=_place)


def _place(one: Difference) -> tuple[str, float, float, str, str, str]:
    shown = one.after or one.before
    assert shown is not None
    return shown.take, shown.start, shown.stop, shown.label, shown.limb, shown.annotator


def _of_group(before: list[Segment], after: list[Segment], tolerance: float) -> list[Difference]:
    found: list[Difference] = []

    def pair(change: Change, old: Segment, new: Segment) -> None:
        found.append(Difference(change, old, new))
        before.remove(old)
        after.remove(new)

    for change, same_class in (("same", True), ("renamed", False)):
        for old in sorted(before, key=lambda one: (one.start, one.stop)):
            fitting = (new for new in after if (new.label == old.label) == same_class and _equal(old, new, tolerance))
            if (match := next(fitting, None)) is not None:
                pair("same" if change == "same" else "renamed", old, match)
    pairs = [(_shared(old, new), old, new) for old in before for new in after if old.label == new.label]
    for share, old, new in sorted(pairs, key=lambda one: (-one[0], one[1].start, one[2].start)):
        if share > 0 and old in before and new in after:
            pair("moved", old, new)
    return [
        *found,
        *(Difference("removed", one, None) for one in before),
        *(Difference("added", None, one) for one in after),
    ]


def _equal(one: Segment, other: Segment, tolerance: float) -> bool:
    return abs(one.start - other.start) <= tolerance and abs(one.stop - other.stop) <= tolerance


def _shared(one: Segment, other: Segment) -> float:
    """Return the intersection over union of two segments."""
    common = min(one.stop, other.stop) - max(one.start, other.start)
    return max(0.0, common) / (max(one.stop, other.stop) - min(one.start, other.start))
