"""Read C3D files: named joints from optical markers."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.storage.formats.motion.c3d_layout import read_layout
from kinedex.storage.formats.motion.c3d_markers import frames_bytes, labels_of, parse_c3d
from kinedex.storage.formats.motion.mapped_body import recognition_warnings
from kinedex.storage.formats.motion.points import body_of_points, points_bytes
from kinedex.storage.formats.motion.points_reader import (
    FittedPoints,
    bodies_of,
    evidence_of,
    points_of_person,
    upright,
)
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, Extent, MotionFile, Reader, ReadSettings


class C3dReader(Reader):
    """Reads C3D files."""

    format: ClassVar[Format] = "c3d"
    endings: ClassVar[tuple[str, ...]] = (".c3d",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap, the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames of the file's layout, and estimate the memory: all markers and a block of them."""
        layout = read_layout(file.path)
        need = points_bytes(layout.frames, layout.points, joints) + frames_bytes(layout)
        rate_hz = next((rate for rate in layout.rates if SLOWEST_HZ <= rate <= FASTEST_HZ), None)
        return Extent(layout.frames, need, rate_hz and settings.rate_of(rate_hz, []))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the subjects of labels such as `Ann:LKNE` that have the landmarks of a body, if there are several."""
        return tuple(bodies_of(labels_of(read_layout(file.path))))

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the markers of a C3D file.

        Raises
        ------
        SourceError
            The file contradicts itself or its size, it holds several persons and none is chosen, no body is recognised,
            or no frame is complete.
        """
        markers, fit, warnings = self.fitted(file, mappings, settings)
        return body_of_points(markers, markers.names, fit, joints, settings, warnings)

    def fitted(self, file: MotionFile, mappings: Mappings, settings: ReadSettings) -> FittedPoints:
        """Read the markers of a C3D file, and recognise the body.

        Raises
        ------
        SourceError
            The file contradicts itself or its size, it holds several persons and none is chosen, or no body is
            recognised.
        """
        markers = points_of_person(parse_c3d(file.path), file.person)
        evidence = evidence_of(markers, markers.up)
        fit = mappings.detect(file.path, "c3d", markers.places(), evidence).upright(markers.up)
        warnings = [*markers.warnings, *recognition_warnings(fit)]
        return FittedPoints(markers, upright(fit, evidence, warnings), warnings)
