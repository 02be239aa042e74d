"""What every reader of motion files gives back, a body, and what the user may say of the files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.catalog.skeletons.units import guess_unit
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.acclaim import RATE_HZ

F64 = npt.NDArray[np.float64]

FARTHEST_M = 100_000.0
"""No body is farther from the origin: a joint beyond this is a fault of the file."""

SHORT_GAP_S = 0.1
"""Gaps up to this long are closed unless the user says otherwise: nobody turns round in a tenth of a second."""


@dataclass(frozen=True)
class Body:
    """The named joints of a take at its source rate.

    positions: float64 (J, 3, T), metres, Y up; NaN for an unknown joint.
    orientation: float64 (4, T), the root's unit quaternion w x y z; NaN where the root is unknown.
    rate_hz: frames per second. unit: what the file's lengths are in, in words. skeleton: the name of the mapping.
    unknown: the joints that the skeleton does not have. warnings: what a reader should know.
    valid: bool (T,), the frames in which all joints but the unknown ones are known; None: all. Other frames are
    invalid: they get no word, and their positions are NaN where they are not known.
    """

    positions: F64
    orientation: F64
    rate_hz: float
    unit: str
    skeleton: str
    unknown: tuple[str, ...]
    warnings: tuple[str, ...]
    valid: npt.NDArray[np.bool_] | None = None

    @property
    def frames(self) -> int:
        """The number of source frames T."""
        return int(self.positions.shape[2])


@dataclass(frozen=True)
class Given:
    """What the user says of an archive's files, where these say nothing or are wrong.

    rate_hz: frames per second of files that do not say it; None: 120 for Acclaim files.
    override_rate_hz: frames per second of every file, whatever it says; None: what the file says.
    fill_gap_frames: the longest gap of a point that is closed along a straight line, a tenth of a second where None;
    frames in a longer one are invalid. body_model: the file of the joints that AMASS files turn, see
    `storage.formats.motion.amass`.
    """

    rate_hz: float | None = None
    override_rate_hz: float | None = None
    fill_gap_frames: int | None = None
    body_model: str | None = None

    @property
    def acclaim_hz(self) -> float:
        """The rate of Acclaim files, which never say it."""
        return self.override_rate_hz or self.rate_hz or RATE_HZ

    def gap_frames(self, rate_hz: float) -> int:
        """The longest gap that is closed, in frames of a file."""
        return round(SHORT_GAP_S * rate_hz) if self.fill_gap_frames is None else self.fill_gap_frames

    def rate_of(self, said_hz: float, warnings: list[str]) -> float:
        """The rate of a file that says one; a warning is added where another one counts."""
        rate_hz = self.override_rate_hz or said_hz
        if abs(rate_hz - said_hz) > 1e-3 * said_hz:
            warnings.append(f"the file says {said_hz:.6g} Hz; it is read at {rate_hz:.6g} Hz, which was given")
        return rate_hz


NOTHING_GIVEN = Given()
"""The user says nothing of the files."""


def built(fit: Fit) -> list[str]:
    """A warning that names the joints built from others, if there are any."""
    named = ", ".join(f"{joint} ({mix})" for joint, mix in fit.virtual.items())
    return [f"joints that the skeleton lacks are built from others: {named}"] if named else []


def to_metres(
    path: Path, positions: F64, unit_m: float | None, joints: tuple[str, ...], warnings: list[str], frame: int = 0
) -> str:
    """Turn positions into metres in place, by a unit that is known or guessed in a frame; returns the unit in words."""
    said = f"{unit_m:.6g} m" if unit_m is not None else ""
    if unit_m is None:
        name, unit_m, height = guess_unit(path, positions[:, :, frame:], joints)
        said = f"{unit_m:.6g} m (guessed)"
        warnings.append(f"its unit of length is guessed: {name}, which makes the body {height:.2f} m high")
    positions *= unit_m
    return said


def refuse_far(
    path: Path,
    positions: F64,
    joints: tuple[str, ...],
    unknown: tuple[str, ...],
    valid: npt.NDArray[np.bool_] | None = None,
) -> None:
    """Raise a SourceError where a joint is so far away that a number of the file must be wrong."""
    if positions.min() >= -FARTHEST_M and positions.max() <= FARTHEST_M:
        return
    far = ~(np.abs(positions) <= FARTHEST_M)  # a NaN is far, too: it comes of infinities
    far[[joints.index(joint) for joint in unknown]] = False
    if valid is not None:
        far &= valid | ~np.isnan(positions)
    if far.any():
        joint, _, frame = (int(at[0]) for at in np.nonzero(far))
        raise SourceError(
            path, f"joint '{joints[joint]}' is more than {FARTHEST_M / 1000:g} km away in source frame {frame}"
        )


def orientation(fit: Fit, turned: F64, own: F64 | None = None) -> F64:
    """The root's quaternion in our axes, from its rotations (9, T) and its own axes where it has some.

    It is the turn between the two frames' bases, seen from ours.
    """
    if "root" in fit.unknown:
        return np.full((4, turned.shape[1]), np.nan)
    root_axes = fit.mapping.root_axes.T
    return kinematics.quaternions(turned, fit.mapping.axes, root_axes if own is None else own @ root_axes)
