"""The reader of C3D files: named joints from optical markers."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.storage.formats.motion.c3d_layout import read_layout
from kinedex.storage.formats.motion.c3d_markers import ezc3d_bytes, parse_c3d
from kinedex.storage.formats.motion.points import body_of_points, points_bytes
from kinedex.storage.formats.motion.points_reader import evidence_of
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, Extent, MotionFile, Reader, ReadSettings


class C3dReader(Reader):
    """Reads C3D files."""

    format: ClassVar[Format] = "c3d"
    endings: ClassVar[tuple[str, ...]] = (".c3d",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames of the file's layout; the memory is that of all markers and of a block in ezc3d."""
        layout = read_layout(file.path)
        need = points_bytes(layout.frames, layout.points, joints) + ezc3d_bytes(layout)
        rate_hz = next((rate for rate in layout.rates if SLOWEST_HZ <= rate <= FASTEST_HZ), None)
        return Extent(layout.frames, need, rate_hz and settings.rate_of(rate_hz, []))

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the markers of a C3D file.

        Raises
        ------
        SourceError
            The file contradicts itself or its size, no mapping fits, or no frame is whole.
        """
        markers = parse_c3d(file.path)
        fit = mappings.detect(file.path, "c3d", markers.places(), evidence_of(markers, markers.up)).upright(markers.up)
        return body_of_points(markers, markers.names, fit, joints, settings, list(markers.warnings))
