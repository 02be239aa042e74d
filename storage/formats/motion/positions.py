"""The reader of joint positions: TRC, CSV, NPZ and NPY files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.storage.formats.motion.mapped_body import virtual_joint_warnings
from kinedex.storage.formats.motion.points import body_of_points, points_bytes
from kinedex.storage.formats.motion.points_reader import evidence_of
from kinedex.storage.formats.motion.position_files import is_positions_csv, parse_positions, positions_extent
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings


class PositionsReader(Reader):
    """Reads files of joint positions; a .csv is one if its header names joints."""

    format: ClassVar[Format] = "positions"
    endings: ClassVar[tuple[str, ...]] = (".trc", ".csv", ".npz", ".npy")

    def sniff(self, path: Path) -> bool:
        """Return whether a .csv has the header of joint positions; other endings need no look."""
        return path.suffix.lower() != ".csv" or is_positions_csv(path)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the rows of a table, or read the header of an array; the memory is that of all points."""
        frames, points, more = positions_extent(file.path)
        need = points_bytes(frames, points, joints) + more
        return Extent(frames, need, settings.override_rate_hz or settings.rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a file of joint positions (TRC, CSV, NPZ, NPY).

        Raises
        ------
        SourceError
            The file is damaged, no mapping fits, no frame is whole, or no rate is known.
        """
        points = parse_positions(file.path)
        warnings = list(points.warnings)
        if not points.names:
            name, names = mappings.names_in_order(file.path, len(points.positions))
            points = replace(points, names=names)
            warnings.append(f"the file does not name its joints; they are read in the order of mapping '{name}'")
        fit = mappings.detect(file.path, "positions", points.places(), evidence_of(points))
        warnings += virtual_joint_warnings(fit)
        return body_of_points(points, points.names, fit, joints, settings, warnings)
