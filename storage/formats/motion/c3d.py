"""The reader of C3D files: named joints from optical markers."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.c3d_layout import read_layout
from kinedex.storage.formats.motion.c3d_markers import Markers, frames_bytes, labels_of, parse_c3d
from kinedex.storage.formats.motion.mapped_body import virtual_joint_warnings
from kinedex.storage.formats.motion.points import body_of_points, points_bytes
from kinedex.storage.formats.motion.points_reader import evidence_of, persons_of, subjects
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, Extent, MotionFile, Reader, ReadSettings

LEAST_LANDMARKS = 8
"""A subject with fewer known labels is a thing that was recorded beside the person, such as a box."""


class C3dReader(Reader):
    """Reads C3D files."""

    format: ClassVar[Format] = "c3d"
    endings: ClassVar[tuple[str, ...]] = (".c3d",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames of the file's layout; the memory is that of all markers and of a block of them."""
        layout = read_layout(file.path)
        need = points_bytes(layout.frames, layout.points, joints) + frames_bytes(layout)
        rate_hz = next((rate for rate in layout.rates if SLOWEST_HZ <= rate <= FASTEST_HZ), None)
        return Extent(layout.frames, need, rate_hz and settings.rate_of(rate_hz, []))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the subjects of labels such as `Ann:LKNE` that have the landmarks of a body, if they are several."""
        labels = labels_of(read_layout(file.path))
        return tuple(persons) if len(persons := _bodies(labels)) > 1 else ()

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the markers of a C3D file.

        Raises
        ------
        SourceError
            The file contradicts itself or its size, it holds several persons and none is asked for, no body is
            recognised, or no frame is whole.
        """
        markers = parse_c3d(file.path)
        persons = _bodies(markers.names)
        if file.person:
            markers = _of_person(markers, file.person)
        elif len(persons) > 1:
            raise SourceError(
                file.path,
                f"holds the markers of {len(persons)} persons, {', '.join(persons)}; ingest makes a take of each",
            )
        fit = mappings.detect(file.path, "c3d", markers.places(), evidence_of(markers, markers.up)).upright(markers.up)
        warnings = [*markers.warnings, *(virtual_joint_warnings(fit) if fit.reasons else [])]
        return body_of_points(markers, markers.names, fit, joints, settings, warnings)


def _bodies(labels: tuple[str, ...]) -> list[str]:
    """Return the subjects of labels that have the landmarks of a body."""
    landmarks, of = load_landmarks(), subjects(labels)
    return [
        name for name in persons_of(labels) if landmarks.read([labels[i] for i in of[name]]).known >= LEAST_LANDMARKS
    ]


def _of_person(markers: Markers, person: str) -> Markers:
    """Return the markers of one subject."""
    of = subjects(markers.names)
    if person not in of:
        raise SourceError(markers.path, f"has no subject '{person}'; its subjects are {', '.join(filter(None, of))}")
    names = tuple(markers.names[i] for i in of[person])
    return replace(markers, names=names, positions=markers.positions[of[person]])
