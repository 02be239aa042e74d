"""Read and write the label files of takes with simulated errors; labels of unchanged takes are kept."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.inertial.broken_takes import LimbLabel, label_text
from kinedex.storage.disk import whole_file
from kinedex.storage.formats.csv_cells import unguarded


class BrokenLabels:
    """The labels of takes with simulated errors, in two files: those of simulated annotators, and the true errors.

    Parameters
    ----------
    labels, truth : Path
        The files, which may exist from an earlier run.
    """

    def __init__(self, labels: Path, truth: Path) -> None:
        self.files = (labels, truth)
        self._labels, self._truth = _read(labels), _read(truth)

    def put(self, take: str, labels: Sequence[LimbLabel], truth: Sequence[LimbLabel]) -> None:
        """Set the labels of a take, by annotators and by the truth."""
        self._labels[take], self._truth[take] = list(labels), list(truth)

    def digest(self, take: str) -> str:
        """Return a hash of the labels of a take; empty if the take is missing in one of the files."""
        if take not in self._labels or take not in self._truth:
            return ""
        return hash_of(label_text([take], self._labels[take]), label_text([take], self._truth[take], with_kinds=True))

    def of(self, takes: Iterable[str]) -> tuple[list[LimbLabel], list[LimbLabel]]:
        """Return the labels of annotators and the true errors of takes."""
        names = list(takes)
        labels, truth = ([one for take in names for one in found[take]] for found in (self._labels, self._truth))
        return labels, truth

    def write(self, takes: Sequence[str]) -> None:
        """Write the labels of takes, in their order, and replace both files."""
        labels, truth = self.of(takes)
        texts = (label_text(takes, labels), label_text(takes, truth, with_kinds=True))
        for path, text in zip(self.files, texts, strict=True):
            with whole_file(path) as temporary:
                temporary.write_bytes(text.encode())


def _read(file: Path) -> dict[str, list[LimbLabel]]:
    """Return the labels by take in a file that `BrokenLabels.write` has made; empty for any other file."""
    found: dict[str, list[LimbLabel]] = {}
    try:
        for row in csv.DictReader(io.StringIO(file.read_bytes().decode(), newline=""), strict=True):
            own = found.setdefault(unguarded(row["take"]), [])
            if row["class"]:
                limb, annotator, kind = (unguarded(row.get(name) or "") for name in ("limb", "annotator", "kind"))
                start, stop, degrees = int(row["start"]), int(row["stop"]), float(row.get("degrees") or "nan")
                own.append(LimbLabel(unguarded(row["take"]), limb, start, stop, annotator, kind, degrees))
    except (OSError, csv.Error, KeyError, TypeError, ValueError):
        return {}
    return found
