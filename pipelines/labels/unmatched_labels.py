"""Count the labels of label files that match no take of a store, and record them in the summaries of stages."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from kinedex.ops.wording import counted, name_list
from kinedex.storage.formats.labels.file_labels import LabelFile

UNMATCHED = "unmatched_labels"
"""The key of labels that match no take, in the summary of a stage and in the JSON output of commands."""


@dataclass(frozen=True)
class UnmatchedLabels:
    """The labels of a file that match no take of a store.

    Attributes
    ----------
    file : str
        The label file.
    labels : int
        The number of its labels that match no take; a named take without a segment counts as one label.
    of : int
        The total number of its labels.
    takes : tuple of str
        The names in the file that match no take.
    """

    file: str
    labels: int
    of: int
    takes: tuple[str, ...]

    def __str__(self) -> str:
        verb = "matches" if self.labels == 1 else "match"
        return f"{self.file}: {self.labels:,} of {counted(self.of, 'label')} {verb} no take: {name_list(self.takes)}"

    def as_json(self) -> dict[str, Any]:
        """Return the attributes as a JSON object."""
        return {**asdict(self), "takes": list(self.takes)}

    @classmethod
    def of_json(cls, known: dict[str, Any]) -> UnmatchedLabels:
        """Make an instance from a JSON object that `as_json` has returned."""
        return cls(known["file"], known["labels"], known["of"], tuple(known["takes"]))


def unmatched_summary(found: Iterable[UnmatchedLabels]) -> dict[str, object]:
    """Return labels that match no take for the summary of a stage, once per file; empty if there are none.

    Every stage that reads label files adds this to its summary, and the run then exits with the status of incomplete
    runs.
    """
    by_file = {one.file: one.as_json() for one in found}
    return {UNMATCHED: list(by_file.values())} if by_file else {}


def recorded_unmatched(summaries: Iterable[Mapping[str, Any]]) -> tuple[UnmatchedLabels, ...]:
    """Return the labels that match no take from the summaries of stages, once per file."""
    recorded = (one for summary in summaries for one in summary.get(UNMATCHED, ()))
    return tuple({one["file"]: UnmatchedLabels.of_json(one) for one in recorded}.values())


def unmatched_labels(files: Iterable[LabelFile], known: Collection[str]) -> tuple[UnmatchedLabels, ...]:
    """Return the labels of files that match no take.

    Parameters
    ----------
    files : iterable of LabelFile
        The label files.
    known : collection of str
        The names of all takes.
    """
    known = frozenset(known)
    found = []
    for file in files:
        counts = dict.fromkeys(file.takes, 0)
        for segment in file.segments:
            counts[segment.take] = counts.get(segment.take, 0) + 1
        labels = {take: max(1, count) for take, count in counts.items()}
        absent = [take for take in labels if take not in known]
        if absent:
            lost, total = sum(labels[take] for take in absent), sum(labels.values())
            found.append(UnmatchedLabels(file.path, lost, total, tuple(absent)))
    return tuple(found)
