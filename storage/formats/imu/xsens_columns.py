"""Read the columns of Xsens text files by name: readings, quaternions, matrices, Euler angles and counters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.ops.inertial.rotations import exp, from_matrix, multiply
from kinedex.storage.formats.imu.number_rows import NumberRows, cells_of, number_rows

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

PACKETS = 1 << 16
"""The number of samples after which PacketCounter wraps to 0."""

CHANNELS = {
    "acc": ("Acc_X", "Acc_Y", "Acc_Z"),
    "gyr": ("Gyr_X", "Gyr_Y", "Gyr_Z"),
    "mag": ("Mag_X", "Mag_Y", "Mag_Z"),
}
"""A dict from each channel to the names of its columns."""

QUATERNIONS: tuple[tuple[str, ...], ...] = (
    ("Quat_q0", "Quat_q1", "Quat_q2", "Quat_q3"),
    ("Quat_w", "Quat_x", "Quat_y", "Quat_z"),
    ("Quat_W", "Quat_X", "Quat_Y", "Quat_Z"),
)
"""The names of the columns of quaternions in different programs."""

_MATRIX = tuple(f"Mat[{row}][{column}]" for row in (1, 2, 3) for column in (1, 2, 3))
_EULER = ("Roll", "Pitch", "Yaw")
COUNTERS = ("PacketCounter", "Counter")
_ANGLES = ("Euler_X", "Euler_Y", "Euler_Z")
_FAR_FROM_TURN = 0.02


class NamedColumns:
    """The columns of a table, which can be read by their names.

    Parameters
    ----------
    path : Path
        The file.
    places : mapping of str to int
        Name of a column → its index in `rows`.
    rows : NumberRows
        The numbers of the table.
    """

    def __init__(self, path: Path, places: Mapping[str, int], rows: NumberRows) -> None:
        self.path, self.indices, self.rows = path, places, rows

    def column(self, name: str) -> F64:
        """Return a column (T,)."""
        return self.rows.numbers[:, self.indices[name]]

    def channel(self, names: Sequence[str]) -> F64 | None:
        """Return the columns with the given names, (T, names); None if none of them exists or all are empty.

        Raises
        ------
        SourceError
            Only some of the columns exist.
        """
        found = [name for name in names if name in self.indices]
        if not found:
            return None
        if len(found) < len(names):
            lacking = ", ".join(name for name in names if name not in self.indices)
            raise SourceError(self.path, f"has the column {found[0]} and lacks {lacking}; export all of them")
        values = self.rows.numbers[:, [self.indices[name] for name in names]]
        return None if np.isnan(values).all() else values

    def orientation(self) -> F64 | None:
        """Return quaternions (T, 4) from the file's quaternions, matrices or Euler angles; None if it has none.

        Raises
        ------
        SourceError
            Some columns of quaternions, matrices or angles are missing, or a matrix is not a rotation.
        """
        for names in QUATERNIONS:
            if (found := self.channel(names)) is not None:
                return found
        if (found := self.channel(_MATRIX)) is not None:
            return self._of_matrices(found.reshape(-1, 3, 3))
        for names in (_EULER, _ANGLES):
            if (found := self.channel(names)) is not None:
                return of_euler(found)
        return None

    def _of_matrices(self, matrices: F64) -> F64:
        known = np.isfinite(matrices).all(axis=(1, 2))
        squares = np.einsum("tij,tkj->tik", matrices[known], matrices[known])
        off = np.abs(squares - np.eye(3)).max(axis=(1, 2)) > _FAR_FROM_TURN
        off |= np.linalg.det(matrices[known]) < 0
        if off.any():
            row = int(np.flatnonzero(known)[np.argmax(off)])
            raise SourceError(
                self.path, "Mat[1][1] … Mat[3][3] are no rotation: a matrix times its transpose must be 1 ± 2 %; "
                "export quaternions", line=int(self.rows.lines[row]),
            )  # fmt: skip
        found = np.full((len(matrices), 4), np.nan)
        if known.any():
            found[known] = from_matrix(matrices[known])
        return found


def named_columns(path: Path, lines: Sequence[str], first: int, separator: str) -> NamedColumns:
    """Read the known columns of a table by their names in line `first` (counted from 0).

    Raises
    ------
    SourceError
        There is no known column, a column occurs twice, or a row is damaged.
    """
    header = cells_of(lines[first], separator)
    known = {name for names in (*CHANNELS.values(), *QUATERNIONS) for name in names}
    known |= {*_MATRIX, *_EULER, *COUNTERS, *_ANGLES, "SampleTimeFine"}
    wanted = [place for place, name in enumerate(header) if name in known]
    names = [header[place] for place in wanted]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SourceError(path, f"has the column {twice} twice", line=first + 1)
    if not set(names) - {*COUNTERS, "SampleTimeFine"}:
        raise SourceError(
            path, f"has no columns of a sensor, such as Acc_X, Gyr_X or Quat_q0; it has {', '.join(header)[:200]}",
            line=first + 1,
        )  # fmt: skip
    rows = number_rows(path, lines, first + 1, separator, header, wanted)
    return NamedColumns(path, {name: i for i, name in enumerate(names)}, rows)


def of_euler(degrees: F64) -> F64:
    """Return the quaternions (T, 4) of roll, pitch and yaw (T, 3) in degrees: Rz(yaw)·Ry(pitch)·Rx(roll)."""
    roll, pitch, yaw = (exp(np.deg2rad(degrees[:, i : i + 1]) * np.eye(3)[i]) for i in range(3))
    return multiply(yaw, multiply(pitch, roll))


def unwrapped(path: Path, counter: F64, lines: I64, wrap: int, name: str) -> I64:
    """Return a wrapping counter as ascending numbers (T,).

    Raises
    ------
    SourceError
        The counter is not an integer, repeats a number, or decreases.
    """
    whole = (counter == np.rint(counter)) & (counter >= 0) & (counter < 1 << 53)
    if not whole.all():
        row = int(np.argmin(whole))
        raise SourceError(path, f"{name} must be a whole number, got {counter[row]:g}", line=int(lines[row]))
    numbers = counter.astype(np.int64)
    wrap = wrap if numbers.max(initial=0) < wrap else 1 << 32 if numbers.max() < 1 << 32 else 1 << 62
    steps = np.diff(numbers) % wrap
    back = (steps == 0) | (steps > wrap // 2)
    if back.any():
        row = int(np.argmax(back)) + 1
        raise SourceError(
            path, f"{name} must ascend, got {numbers[row]} after {numbers[row - 1]}; cut the file where "
            "a new recording begins", line=int(lines[row]),
        )  # fmt: skip
    found: I64 = np.concatenate([numbers[:1], numbers[0] + np.cumsum(steps)])
    return found
