"""Read files of joint positions: TRC, CSV, NPZ and NPY."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.points import recognise_points
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import recognition_warnings
from kinedex.storage.formats.motion.points import Points, body_of_points, points_bytes
from kinedex.storage.formats.motion.points_reader import (
    FittedPoints,
    bodies_of,
    evidence_of,
    points_of_person,
    upright,
)
from kinedex.storage.formats.motion.position_files import is_positions_csv, parse_positions, positions_extent, trc_head
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings


class PositionsReader(Reader):
    """Reads files of joint positions; a .csv file counts as one if its header names joints."""

    format: ClassVar[Format] = "positions"
    endings: ClassVar[tuple[str, ...]] = (".trc", ".csv", ".npz", ".npy")

    def sniff(self, path: Path) -> bool:
        """Return whether a .csv has the header of joint positions; for other extensions return True."""
        return path.suffix.lower() != ".csv" or is_positions_csv(path)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap, the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the rows of a table, or read the header of an array, and estimate the memory: all points."""
        frames, points, more = positions_extent(file.path)
        need = points_bytes(frames, points, joints) + more
        return Extent(frames, need, settings.override_rate_hz or settings.rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a file of joint positions (TRC, CSV, NPZ, NPY).

        Raises
        ------
        SourceError
            The file is damaged, no mapping fits, no frame is complete, or no rate is known.
        """
        points, fit, warnings = self.fitted(file, mappings, settings)
        return body_of_points(points, points.names, fit, joints, settings, warnings)

    def fitted(self, file: MotionFile, mappings: Mappings, settings: ReadSettings) -> FittedPoints:
        """Read a file of joint positions, and recognise the body.

        Raises
        ------
        SourceError
            The file is damaged, or no mapping fits.
        """
        points = points_of_person(parse_positions(file.path), file.person)
        warnings = list(points.warnings)
        if not points.names:
            called, names = _names_in_order(points, mappings)
            points = replace(points, names=names)
            warnings.append(f"the file does not name its joints; they are read in the order of {called}")
        evidence = evidence_of(points)
        fit = mappings.detect(file.path, "positions", points.places(), evidence)
        warnings += recognition_warnings(fit)
        if "positions" not in mappings.forced:
            fit = upright(fit, evidence, warnings)
        return FittedPoints(points, fit, warnings)

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the subjects of the labels of a TRC file that have the landmarks of a body, if there are several."""
        return tuple(bodies_of(trc_head(file.path).labels)) if file.path.suffix.lower() == ".trc" else ()


def _names_in_order(points: Points, mappings: Mappings) -> tuple[str, tuple[str, ...]]:
    """Return names for unnamed points, and their origin: of the orders with this number, the most body-like one."""
    count = len(points.positions)
    orders = {f"mapping '{each.name}'": each.order for each in mappings.of("positions") if len(each.order) == count}
    if "positions" not in mappings.forced:
        orders |= {name: order for name, order in load_landmarks().orders.items() if len(order) == count}
    if len(orders) < 2:
        name, names = next(iter(orders.items()), None) or mappings.names_in_order(points.path, count)
        return name, names
    return max(orders.items(), key=lambda item: _likeness(points, item[1], mappings.joints))


def _likeness(points: Points, order: tuple[str, ...], joints: tuple[str, ...]) -> float:
    """Return the confidence, from 0 to 1, that points in an order form a body."""
    try:
        return recognise_points(points.path, evidence_of(replace(points, names=order)), joints).confidence
    except SourceError:
        return 0.0
