"""Read C3D files: named joints from optical markers, whose frames are integers or floats in three byte orders.

The frames are a plain array of four numbers for every marker (x, y, z and its residual) and the analog samples. The
layout that `c3d_layout` has checked against the file's size gives their offset (docs/decisions/0007).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.catalog.skeletons.units import STATED_UNITS_M
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.c3d_layout import DEC, Layout, order_of, read_layout, real
from kinedex.storage.formats.motion.mapped_body import recognition_warnings
from kinedex.storage.formats.motion.numpy_arrays import MAX_BYTES
from kinedex.storage.formats.motion.points import (
    FittedPoints,
    Points,
    body_of_points,
    completed,
    evidence_of,
    points_bytes,
    trial_bytes,
    upright,
)
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, Extent, MotionFile, Reader, ReadSettings
from kinedex.storage.formats.motion.shared_labels import unique_names
from kinedex.storage.formats.motion.subjects import bodies_of, points_of_person
from kinedex.storage.formats.source_files import source_errors

F64 = npt.NDArray[np.float64]

_BLOCK_NUMBERS = 4_000_000  # numbers of the frames decoded at once: some 50 MB


@dataclass(frozen=True)
class Markers(Points):
    """The markers of a C3D file.

    Attributes
    ----------
    up : str, optional
        The axis that the file states as vertical: "x", "y" or "z".
    """

    up: str | None = None


def parse_c3d(path: Path) -> Markers:
    """Read the markers of a C3D file.

    A marker counts as missing, NaN, if its residual is negative, a coordinate is NaN, or it lies at 0, 0, 0.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Markers
        The markers by their labels, which may begin with a subject's name; rate, unit and up axis as far as the file
        states them. Of labels that several markers share see `unique_names`.

    Raises
    ------
    SourceError
        The file contradicts itself or its size.
    """
    layout = read_layout(path)
    if 24 * layout.points * layout.frames > MAX_BYTES:
        size = 24 * layout.points * layout.frames / 1e9
        raise SourceError(
            path, f"takes {size:.1f} GB in memory; write shorter takes, of {MAX_BYTES / 1e9:.1f} GB at most"
        )
    positions = np.empty((layout.points, 3, layout.frames))
    step = _frames_at_once(layout)
    for start in range(0, layout.frames, step):
        stop = min(start + step, layout.frames)
        positions[:, :, start:stop] = _decode(path, layout, start, stop)
    lost = np.isnan(positions).any(axis=1) | (positions == 0.0).all(axis=1)
    positions[np.broadcast_to(lost[:, None], positions.shape)] = np.nan
    warnings = list(layout.warnings)
    labels = labels_of(layout)
    if np.isinf(positions).any():
        point, _, frame = (int(at[0]) for at in np.nonzero(np.isinf(positions)))
        raise SourceError(path, f"marker '{labels[point]}' is infinitely far away in source frame {frame}")
    if layout.first > 1:
        warnings.append(f"it begins with frame {layout.first} of its recording, which is source frame 0 here")
    rate_hz, unit_m, up = _rate(layout, warnings), _unit_m(layout, warnings), _up(layout, warnings)
    names = unique_names(labels, positions, unit_m, warnings)
    return Markers(str(path), names, positions, rate_hz, None, unit_m, warnings, up=up)


def frames_bytes(layout: Layout) -> int:
    """Return the memory of a block of frames, as the file has them and decoded."""
    row = 4 * layout.points + layout.analog
    return min(layout.frames, _frames_at_once(layout)) * (2 * layout.size * row + 40 * layout.points)


def _frames_at_once(layout: Layout) -> int:
    return max(1, _BLOCK_NUMBERS // (4 * layout.points + layout.analog))


def _decode(path: Path, layout: Layout, start: int, stop: int) -> F64:
    """Return the frames [start, stop) as (points, 3, frames), NaN where the residual is negative."""
    row, count = 4 * layout.points + layout.analog, stop - start
    kind = np.dtype(f"{order_of(layout.processor)}{'i2' if layout.size == 2 else 'f4'}")
    with source_errors(path):
        raw = np.fromfile(path, np.uint8, count * row * layout.size, offset=layout.start + start * row * layout.size)
    if len(raw) != count * row * layout.size:
        raise SourceError(path, "was changed while it was read; run again when it is whole")
    if layout.size == 4 and layout.processor == DEC:  # exchanged 16-bit halves, and four times too large
        raw = raw.view("<u2").reshape(-1, 2)[:, ::-1].copy().view(np.uint8).reshape(-1)
    numbers = raw.view(kind).reshape(count, row)[:, : 4 * layout.points].reshape(count, layout.points, 4)
    with np.errstate(invalid="ignore", over="ignore"):
        positions = numbers[:, :, :3].astype(np.float64)
        if layout.size == 2:
            positions *= real(layout.scale, layout.processor)
        elif layout.processor == DEC:
            positions /= 4.0
        positions[numbers[:, :, 3] < 0] = np.nan
    return positions.transpose(1, 2, 0)


def _texts(layout: Layout, name: str) -> list[str]:
    return layout.parameters[name].texts if name in layout.parameters else []


def labels_of(layout: Layout) -> tuple[str, ...]:
    """Return the labels of all markers, also from POINT:LABELS2 and on; markers without a label are numbered."""
    labels = _texts(layout, "LABELS")
    for key in sorted(
        (key for key in layout.parameters if re.fullmatch(r"LABELS\d+", key)), key=lambda key: int(key[6:])
    ):
        labels += _texts(layout, key)
    named = [label or f"unnamed {i}" for i, label in enumerate(labels[: layout.points])]
    return (*named, *(f"unnamed {i}" for i in range(len(named), layout.points)))


def _rate(layout: Layout, warnings: list[str]) -> float | None:
    """Return POINT:RATE, else the header's rate, None if neither is possible; warn if they differ."""
    good = [rate for rate in layout.rates if SLOWEST_HZ <= rate <= FASTEST_HZ]
    if not good:
        return None
    if len(good) == 2 and abs(good[0] - good[1]) > 0.01 * good[0]:
        warnings.append(f"its parameters state {good[0]:.6g} Hz, which counts, its header {good[1]:.6g} Hz")
    return good[0]


def _unit_m(layout: Layout, warnings: list[str]) -> float | None:
    """Return the metres per unit named by POINT:UNITS; None if it is missing or unknown."""
    units = [unit.lower() for unit in _texts(layout, "UNITS") if unit]
    if not units:
        return None
    if units[0] not in STATED_UNITS_M:
        warnings.append(f"its unit {units[0]!r} is none of {', '.join(STATED_UNITS_M)}")
    return STATED_UNITS_M.get(units[0])


def _up(layout: Layout, warnings: list[str]) -> str | None:
    """Return the axis that POINT:Y_SCREEN states as vertical; None if it is missing.

    The sign is ignored: in files of all systems the floor is at 0, and some write −Z although Z is up.
    """
    text = next((text.lower() for text in _texts(layout, "Y_SCREEN") if text), "")
    if not re.fullmatch(r"[+-]?[xyz]", text):
        return None
    if text[0] == "-":
        warnings.append(f"POINT:Y_SCREEN is {text.upper()}; {text[-1].upper()} is taken to point up")
    return text[-1]


def _size(file: MotionFile) -> tuple[int, int, int]:
    layout = read_layout(file.path)
    return layout.frames, layout.points, frames_bytes(layout)


def _of_trial(trial: Path, person: str) -> Markers:
    """Return the markers of a static trial, those of the same person if it has several."""
    markers = parse_c3d(trial)
    return points_of_person(markers, person if person in bodies_of(markers.names) else "")


class C3dReader(Reader):
    """Reads C3D files."""

    format: ClassVar[Format] = "c3d"
    endings: ClassVar[tuple[str, ...]] = (".c3d",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap, the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames of the file's layout, and estimate the memory of all markers and a block of frames."""
        layout = read_layout(file.path)
        need = points_bytes(layout.frames, layout.points, joints) + frames_bytes(layout)
        need += trial_bytes(file.skeleton, _size)
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
        markers = points_of_person(parse_c3d(file.path), file.person).seen()
        markers = completed(markers, file.skeleton, lambda trial: _of_trial(trial, file.person))
        evidence = evidence_of(markers, markers.up)
        fit = mappings.detect(file.path, "c3d", markers.indices(), evidence).upright(markers.up)
        warnings = [*markers.warnings, *recognition_warnings(fit)]
        return FittedPoints(markers, upright(fit, evidence, warnings, settings.session_up), warnings)
