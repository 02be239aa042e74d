"""The reader of C3D files: named joints from optical markers."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.storage.formats.motion.c3d_markers import parse_c3d
from kinedex.storage.formats.motion.points import body_of_points
from kinedex.storage.formats.motion.reader import Body, MotionFile, Reader, ReadSettings


class C3dReader(Reader):
    """Reads C3D files."""

    format: ClassVar[Format] = "c3d"
    endings: ClassVar[tuple[str, ...]] = (".c3d",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the markers of a C3D file.

        Raises
        ------
        SourceError
            The file contradicts itself or its size, no mapping fits, or no frame is whole.
        """
        markers = parse_c3d(file.path)
        fit = mappings.detect(file.path, "c3d", markers.places()).upright(markers.up)
        return body_of_points(markers, markers.names, fit, joints, settings, list(markers.warnings))
