"""Read the points of a file as a body, in steps that the readers of many formats share."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np

from kinedex.catalog.skeletons.evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.recognised_tree import joint_places
from kinedex.catalog.skeletons.skeleton_fit import Fit, axes_of_up
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import recognition_warnings
from kinedex.storage.formats.motion.points import Points, body_of_points, points_bytes
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings

LEAST_LANDMARKS = 8
"""The smallest number of known labels of a subject that counts as a person."""

SURE_UP = 0.75
"""The confidence from which a body is rotated upright, or the file's up axis is doubted."""

LEAST_POINTS = 10
"""The smallest number of points of a person; a subject with fewer is an object, such as a box or a racket."""


class FittedPoints(NamedTuple):
    """The points of a file with the mapping that fits them, and warnings about both."""

    points: Points
    fit: Fit
    warnings: list[str]


class PointsReader(Reader):
    """A reader of files that hold points by name; subclasses define `points`, `size` and optionally `persons`.

    Attributes
    ----------
    up : str, optional
        The axis that is vertical in all files of the format.
    """

    format: ClassVar[Format] = "positions"
    up: ClassVar[str | None] = None

    @abstractmethod
    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Return the points of a file, or of the chosen person.

        Raises
        ------
        SourceError
            The file is damaged, or holds no points.
        """

    @abstractmethod
    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return frames and points of a file, and the bytes of memory for reading besides those of the points.

        Raises
        ------
        SourceError
            The file cannot be read.
        """

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap, the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the number of frames, and the estimated memory for all points and the body computed from them."""
        frames, points, more = self.size(file)
        return Extent(frames, points_bytes(frames, points, joints) + more, settings.override_rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the points of a file, recognise the body, and build its joints.

        Raises
        ------
        SourceError
            The file is damaged, the body is not recognised, no frame is complete, or no rate is known.
        """
        points, fit, warnings = self.fitted(file, mappings, settings)
        return body_of_points(points, points.names, fit, joints, settings, warnings)

    def fitted(self, file: MotionFile, mappings: Mappings, settings: ReadSettings) -> FittedPoints:
        """Read the points of a file, and recognise the body.

        Raises
        ------
        SourceError
            The file is damaged, or the body is not recognised.
        """
        points = self.points(file, settings)
        evidence = evidence_of(points, self.up)
        fit = mappings.detect(file.path, "positions", points.places(), evidence)
        warnings = [*points.warnings, *recognition_warnings(fit)]
        if "positions" not in mappings.forced:
            fit = upright(fit, evidence, warnings)
        return FittedPoints(points, fit, warnings)


def evidence_of(points: Points, up: str | None = None) -> Evidence:
    """Return the evidence for recognising a body: positions in some frames of the points present in any frame.

    Parameters
    ----------
    points : Points
        The points of a file.
    up : str, optional
        The axis that the file states as vertical.
    """
    seen = points.places()
    frames = points.positions.shape[2]
    sample = np.unique(np.linspace(0, frames - 1, min(frames, SAMPLED_FRAMES)).astype(int))
    return Evidence(tuple(seen), points.positions[list(seen.values())][:, :, sample], up=up, unit_m=points.unit_m)


def upright(fit: Fit, evidence: Evidence, warnings: list[str]) -> Fit:
    """Return the fit rotated upright if no up axis is stated; warn if the body contradicts the stated axis.

    Parameters
    ----------
    fit : Fit
        The mapping over the points.
    evidence : Evidence
        The points in some frames, and the axis that the file states as vertical.
    warnings : list of str
        A sentence is appended if the body stands along another axis than the file states.
    """
    if fit.mapping.unit_m is not None and evidence.up is None:
        return fit  # the mapping of a single archive states its axes
    judged = up_axis(joint_places(fit, evidence.places, None)[0])
    index = int(np.argmax(np.abs(fit.mapping.axes[1])))
    taken = ("-" if fit.mapping.axes[1, index] < 0 else "") + "xyz"[index]
    if not judged.axis and evidence.up is None:
        warnings.append(f"no axis is clearly up ({'; '.join(judged.reasons)}): {taken} is taken")
    if not judged.axis or judged.axis == taken or judged.confidence < SURE_UP:
        return fit
    if evidence.up is not None:
        warnings.append(
            f"the file states that {taken} is up, which counts, but its body stands along {judged.axis} "
            f"({judged.reasons[0]}); if it lies on its side, give a mapping of your own with `up` and `screen: false`"
        )
        return fit
    reasons = (*fit.reasons, f"{judged.axis} is up: " + "; ".join(judged.reasons))
    return replace(fit, mapping=replace(fit.mapping, axes=axes_of_up(judged.axis)), reasons=reasons)


def bodies_of(labels: Sequence[str]) -> list[str]:
    """Return the subjects of labels such as `Ann:LKNE` that have the landmarks of a body."""
    landmarks, of = load_landmarks(), subjects(labels)
    many = [
        name for name in persons_of(labels) if landmarks.read([labels[i] for i in of[name]]).known >= LEAST_LANDMARKS
    ]
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
    found = [name for name, places in subjects(labels).items() if name and len(places) >= LEAST_POINTS]
    return tuple(found) if len(found) > 1 else ()


def labels_of_person(
    path: Path, labels: Sequence[str], person: str, warnings: list[str]
) -> tuple[list[int], tuple[str, ...]]:
    """Return the labels of one person: of the chosen subject, or else of the only possible person.

    Parameters
    ----------
    path : Path
        The file, for errors.
    labels : sequence of str
        All labels of a file.
    person : str
        The chosen subject; empty for a file of one person.
    warnings : list of str
        Sentences are appended on subjects and labels that are not used.

    Returns
    -------
    places : list of int
        Indices of the labels that are used.
    names : tuple of str
        Their names without the subject.

    Raises
    ------
    SourceError
        There are several persons, and none is chosen.
    """
    of = subjects(labels)
    bodies = bodies_of(labels)
    if bodies and person not in of:
        raise SourceError(path, f"holds {len(bodies)} persons, {', '.join(bodies)}; ingest makes a take of each")
    whole = [name for name, places in of.items() if name and len(places) >= LEAST_POINTS]
    if len(whole) > 1:
        known = load_landmarks()
        whole = [name for name in whole if known.read([labels[i] for i in of[name]]).known >= LEAST_LANDMARKS] or whole
    chosen = person if person in of else whole[0] if len(whole) == 1 else None
    places = list(range(len(labels))) if chosen is None else of[chosen]
    short = [labels[i] if chosen is None else labels[i].rpartition(":")[2] for i in places]
    others = [name for name in of if name and name != chosen and name not in bodies]
    if chosen is not None and others:
        warnings.append(f"points of {', '.join(others[:6])} are not used: they are none of a person's")
    twice = sorted(name for name, count in Counter(short).items() if count > 1)
    if twice:
        warnings.append(f"{', '.join(twice[:6])} stand for several points each, and are not used")
    kept = [(i, name) for i, name in zip(places, short, strict=True) if name not in twice]
    return [i for i, _ in kept], tuple(name for _, name in kept)
