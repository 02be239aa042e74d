"""Find markers that share a label, join the copies of one marker, and give every other marker a name of its own."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

_COPY = re.compile(r"(.*\S)\s*\((\d{1,3})\)|(.*[^\W_])_(\d)")
_SAME_M = 0.001
_SAME_SHARE = 6e-4  # of the size of all points in a frame, 1 mm of a person: stated units may be wrong
_SAMPLED = 200
_SHOWN = 6


def unique_names(labels: Sequence[str], positions: F64, unit_m: float | None, warnings: list[str]) -> tuple[str, ...]:
    """Return a name for every marker, of which no two are equal, after copies of one marker are joined in place.

    Markers are copies of one if they have the same label, or this label with a number as in `RKNE (1)` or `RKNE_1`, and
    all but one are never seen, or they lie within 1 mm of each other wherever two are seen. The first copy gets all
    positions, the others become unseen. Seen markers of one label that are no copies are numbered.

    Parameters
    ----------
    labels : sequence of str
        The labels of N markers.
    positions : float64 array (N, 3, T)
        Positions, NaN where a marker is not seen; changed in place where copies are joined.
    unit_m : float, optional
        Metres per unit, if the file states it.
    warnings : list of str
        Sentences are appended on copies that are joined, and on labels that stand for different points.
    """
    names = list(labels)
    alike = _alike(labels)
    if alike:
        seen = np.isfinite(positions.sum(axis=1)).any(axis=1)
        joined, different, nearest = list[str](), list[str](), _nearest(positions, unit_m)
        for label, copies in alike.items():
            there = [i for i in copies if seen[i]]
            if len(there) > 1 and not _same(positions[there], nearest):
                if sum(labels[i] == label or labels[i].endswith(")") for i in there) > 1:
                    different += [label for i in there if labels[i] == label][:1]
                continue
            if len(there) > 1 or (there and labels[there[0]] != label):
                joined.append(f"{label} ({len(there)} copies)" if len(there) > 1 else f"{label} ({labels[there[0]]})")
                _join(positions, there)
            if there:
                names[there[0]] = label
                for i in copies:
                    if i != there[0] and names[i] == label:
                        names[i] = ""
        names = _numbered(names, frozenset(different))
        if joined:
            warnings.append(
                "labels with a number, or of several markers, whose copies are never seen or lie at one place, are "
                f"taken for one marker: {_listed(joined)}"
            )
        if different:
            warnings.append(f"several markers are called {_listed(different)}; none of them is used")
    return tuple(names)


def _listed(texts: Sequence[str]) -> str:
    return ", ".join(texts[:_SHOWN]) + (f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else "")


def _alike(labels: Sequence[str]) -> Mapping[str, list[int]]:
    """Return a dict from label to the indices of at least two markers that may be copies of the same marker."""
    whole = set(labels)
    found: dict[str, list[int]] = {}
    for i, label in enumerate(labels):
        copy = _COPY.fullmatch(label)
        found.setdefault((copy[1] or _bare(copy, whole) or label) if copy else label, []).append(i)
    return {label: places for label, places in found.items() if len(places) > 1}


def _bare(copy: re.Match[str], whole: set[str]) -> str | None:
    """Return the label before the number of a copy, if the file has this label and no second numbered one, else None.

    A label with several numbers names the markers of a cluster.
    """
    label = copy[3]
    others = sum(f"{label}_{number}" in whole for number in range(10))
    return label if label in whole and others == 1 else None


def _nearest(positions: F64, unit_m: float | None) -> float:
    """Return the largest distance between copies of one marker, in the unit of the positions."""
    some = positions[:, :, :: max(1, positions.shape[2] // _SAMPLED)]
    with np.errstate(invalid="ignore"):
        low = np.where(np.isfinite(some), some, np.inf).min(axis=0)
        high = np.where(np.isfinite(some), some, -np.inf).max(axis=0)
        sizes = (high - low).max(axis=0)
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    by_size = _SAME_SHARE * float(np.median(sizes)) if len(sizes) else 0.0
    return min(by_size, _SAME_M / unit_m) if unit_m else by_size


def _same(copies: F64, nearest: float) -> bool:
    """Return whether copies (n, 3, T) lie together wherever two are seen; each must be seen together with another."""
    for i, one in enumerate(copies):
        away = np.sqrt(((np.delete(copies, i, axis=0) - one) ** 2).sum(axis=1))
        away = away[np.isfinite(away)]
        if not len(away) or away.max() > nearest:
            return False
    return True


def _join(positions: F64, copies: Sequence[int]) -> None:
    """Fill the gaps of the first marker with the positions of its copies, and set those of the copies to NaN."""
    first = positions[copies[0]]
    for i in copies[1:]:
        hidden = np.isnan(first).any(axis=0)
        first[:, hidden] = positions[i][:, hidden]
        positions[i] = np.nan


def _numbered(names: Sequence[str], different: frozenset[str]) -> list[str]:
    """Return names of which no two are equal: repeated ones, those to avoid and empty ones get a number."""
    counts = Counter(names)
    used = set(names)
    unique = []
    for name in names:
        if name in different or not name or counts[name] > 1:
            name = _free(name or "unseen copy", used)
            used.add(name)
        unique.append(name)
    return unique


def _free(name: str, used: Iterable[str]) -> str:
    return next(found for found in _numbers(name) if found not in used)


def _numbers(name: str) -> Iterator[str]:
    number = 1
    while True:
        yield f"{name} ({number})"
        number += 1
