"""Tell the subjects of a file of points apart by the prefixes of labels, and find those that are persons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.points import Points

MIN_LANDMARKS = 8
"""The smallest number of known labels of a subject that counts as a person."""

MIN_POINTS = 10
"""The smallest number of points of a person; a subject with fewer is an object, such as a box or a racket."""


def bodies_of(labels: Sequence[str]) -> list[str]:
    """Return the subjects of labels such as `Ann:LKNE` that have the landmarks of a body; empty unless several have."""
    landmarks, of = load_landmarks(), subjects(labels)
    many = [name for name in persons_of(labels) if landmarks.read([labels[i] for i in of[name]]).known >= MIN_LANDMARKS]
    return many if len(many) > 1 else []


AnyPoints = TypeVar("AnyPoints", bound=Points)


def points_of_person(points: AnyPoints, person: str) -> AnyPoints:
    """Return the points of one subject of a file, or all if no person is chosen.

    Raises
    ------
    SourceError
        There is no such subject, or there are several and none is chosen.
    """
    of = subjects(points.names)
    if not person:
        bodies = bodies_of(points.names)
        if bodies:
            raise SourceError(
                points.path,
                f"holds the markers of {len(bodies)} persons, {', '.join(bodies)}; ingest makes a take of each",
            )
        return points
    if person not in of:
        raise SourceError(points.path, f"has no subject '{person}'; its subjects are {', '.join(filter(None, of))}")
    names = tuple(points.names[i] for i in of[person])
    return replace(points, names=names, positions=points.positions[of[person]])


def subjects(labels: Sequence[str]) -> dict[str, list[int]]:
    """Return a dict from subject to label indices; `Ann:LFHD` has subject `Ann`, labels without a prefix ""."""
    found: dict[str, list[int]] = {}
    for i, label in enumerate(labels):
        found.setdefault(label.rpartition(":")[0], []).append(i)
    return found


def persons_of(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the subjects with enough points for a person if there are several; else nothing."""
    found = [name for name, positions in subjects(labels).items() if name and len(positions) >= MIN_POINTS]
    return tuple(found) if len(found) > 1 else ()


def labels_of_person(
    path: Path, labels: Sequence[str], person: str, warnings: list[str]
) -> tuple[list[int], tuple[str, ...]]:
    """Return the labels of one person: of the chosen subject, else of the only possible person, else all labels.

    Parameters
    ----------
    path : Path
        The file, for errors.
    labels : sequence of str
        All labels of a file.
    person : str
        The chosen subject; empty for a file of one person.
    warnings : list of str
        A sentence is appended on subjects that are not used.

    Returns
    -------
    places : list of int
        Indices of the labels that are used.
    names : tuple of str
        Their names without the subject, of which some may be equal.

    Raises
    ------
    SourceError
        There are several persons, and none is chosen.
    """
    of = subjects(labels)
    bodies = bodies_of(labels)
    if bodies and person not in of:
        raise SourceError(path, f"holds {len(bodies)} persons, {', '.join(bodies)}; ingest makes a take of each")
    whole = [name for name, positions in of.items() if name and len(positions) >= MIN_POINTS]
    if len(whole) > 1:
        known = load_landmarks()
        whole = [name for name in whole if known.read([labels[i] for i in of[name]]).known >= MIN_LANDMARKS] or whole
    chosen = person if person in of else whole[0] if len(whole) == 1 else None
    positions = list(range(len(labels))) if chosen is None else of[chosen]
    short = [labels[i] if chosen is None else labels[i].rpartition(":")[2] for i in positions]
    others = [name for name in of if name and name != chosen and name not in bodies]
    if chosen is not None and others:
        warnings.append(f"points of {', '.join(others[:6])} are not used: they are none of a person's")
    return positions, tuple(short)
