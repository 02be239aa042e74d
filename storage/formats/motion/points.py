"""Convert points over time, such as joint positions and markers, to a body.

Short gaps are filled by linear interpolation; frames in longer gaps are invalid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.body import kinematics
from kinedex.ops.body.gaps import Gap, fill_gaps
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import recognition_evidence, refuse_far, to_metres
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, ReadSettings, body_bytes

F64 = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_AT_ONCE = 16_384  # frames at once: some 10 MB of joints
_SPINE = ("chest", "neck", "belly", "head")  # the first known one gives the root's up direction


@dataclass(frozen=True)
class Points:
    """Named points over time, in the file's own unit and axes.

    Attributes
    ----------
    path : str
        The file.
    names : tuple of str
        Names of the points; empty if the file names none.
    positions : float64 array (N, 3, T)
        Positions of the points; NaN where a point is missing.
    rate_hz : float, optional
        Frames per second, if the file states them.
    clock_hz : float, optional
        Frames per second by the file's time stamps, if it has any.
    unit_m : float, optional
        Metres per unit, if the file states it.
    warnings : list of str
        Warnings about the file.
    """

    path: str
    names: tuple[str, ...]
    positions: F64
    rate_hz: float | None = None
    clock_hz: float | None = None
    unit_m: float | None = None
    warnings: list[str] = field(default_factory=list)

    def places(self, names: Sequence[str] = ()) -> dict[str, int]:
        """Return a dict from name to index of the points present in any frame; `names` replaces missing names."""
        seen = np.count_nonzero(np.isfinite(self.positions), axis=(1, 2)) > 0
        return {name: i for i, name in enumerate(self.names or names) if seen[i]}


def points_bytes(frames: int, points: int, joints: int) -> int:
    """Estimate the memory in bytes of points, of the body made of them, and of intermediate arrays."""
    masks, gaps = 4 * 3 * points * frames, 100 * frames
    return 24 * points * frames + masks + gaps + body_bytes(frames, joints) + min(frames, _AT_ONCE) * 96 * joints


def body_of_points(
    points: Points,
    names: tuple[str, ...],
    fit: Fit,
    joints: tuple[str, ...],
    settings: ReadSettings,
    warnings: list[str],
) -> Body:
    """Convert points to a body; the root's orientation follows from hips and spine, since points have none.

    Parameters
    ----------
    points : Points
        The points of a file; short gaps are filled in them.
    names : tuple of str
        Their names.
    fit : Fit
        The skeleton mapping that fits the names.
    joints : tuple of str
        The named joints, in the order of the result.
    settings : ReadSettings
        Settings of the user.
    warnings : list of str
        Warnings about the file, to which more are appended.

    Raises
    ------
    SourceError
        No rate is known, no frame is complete, or a joint is implausibly far away.
    """
    path = Path(points.path)
    rate_hz = _rate(points, settings, warnings)
    longest = settings.gap_frames(rate_hz)
    used = list(fit.nodes)
    closed, left = _fill(points.positions, used, longest)
    positions = _placed(points.positions, fit, joints)
    known = [i for i, joint in enumerate(joints) if joint not in fit.unknown]
    valid: Mask = np.ones(positions.shape[2], np.bool_)
    for i in known:
        valid &= np.logical_not(np.isnan(positions[i]).any(axis=0))
    called = [names[index] for index in used]
    if closed:
        warnings.append(f"gaps closed along straight lines: {_gaps_in_words(closed, called)}")
    if not valid.all():
        lost = [joints[i] for i in known if np.isnan(positions[i]).any()]
        warnings.append(_invalid(path, fit, valid, left, longest, called, lost))
    first = int(np.argmax(valid))
    stated = points.unit_m is not None
    evidence = list(recognition_evidence(fit))
    unit = to_metres(path, positions, points.unit_m or fit.mapping.unit_m, joints, warnings, evidence, first, stated)
    refuse_far(path, positions, joints, fit.unknown, valid)
    return Body(
        positions=positions,
        orientation=root_orientation(positions, joints, valid, warnings),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=tuple(warnings),
        valid=None if valid.all() else valid,
        estimated=tuple(fit.estimated),
        confidence=fit.confidence,
        evidence=tuple(evidence),
    )


def _rate(points: Points, settings: ReadSettings, warnings: list[str]) -> float:
    """Return the rate to use; append a warning if the file contradicts itself or the user."""
    if points.rate_hz is not None:
        rate_hz = settings.rate_of(points.rate_hz, warnings)
    elif (set_hz := settings.override_rate_hz or settings.rate_hz) is not None:
        rate_hz = set_hz
    elif points.clock_hz is not None and SLOWEST_HZ <= points.clock_hz <= FASTEST_HZ:
        rate_hz = points.clock_hz
    else:
        raise SourceError(points.path, "does not state its frames per second: give `rate_hz`, or --rate")
    if points.clock_hz is not None and abs(points.clock_hz - rate_hz) > 0.01 * rate_hz:
        warnings.append(f"it is read at {rate_hz:.6g} Hz, but by the times in the file it is {points.clock_hz:.6g} Hz")
    return rate_hz


def _fill(positions: F64, used: list[int], longest: int) -> tuple[list[Gap], list[Gap]]:
    """Fill short gaps of the used points in place; return filled and remaining gaps, with indices into `used`."""
    closed: list[Gap] = []
    left: list[Gap] = []
    for place, index in enumerate(used):
        if np.isnan(positions[index]).any():
            (positions[index],), *gaps = fill_gaps(positions[index : index + 1], longest)
            for found, of_point in zip((closed, left), gaps, strict=True):
                found += [replace(gap, point=place) for gap in of_point]
    return closed, left


def _placed(points: F64, fit: Fit, joints: tuple[str, ...]) -> F64:
    """Return the named joints (J, 3, T), built in blocks of frames."""
    frames = points.shape[2]
    positions = np.empty((len(joints), 3, frames))
    for start in range(0, frames, _AT_ONCE):
        stop = start + _AT_ONCE
        positions[:, :, start:stop] = fit.apply(points[:, :, start:stop], joints)
    return positions


def _invalid(
    path: Path, fit: Fit, valid: Mask, left: list[Gap], longest: int, names: list[str], lost: list[str]
) -> str:
    """Describe the invalid frames, their number and the missing points; raise SourceError if all frames are invalid."""
    blamed = [gap for gap in left if not valid[gap.start : gap.stop].all()]
    unplaced = ~valid
    for gap in blamed:
        unplaced[gap.start : gap.stop] = False
    if unplaced.any():
        raise SourceError(
            path,
            f"{', '.join(lost)} cannot be placed in source frame {int(np.argmax(unplaced))}, though all points are "
            "there: one of them is too far away",
        )
    reason = (
        f"points that the mapping '{fit.mapping.name}' takes are missing for more than {longest} frames: "
        f"{_gaps_in_words(blamed, names)}"
    )
    if not valid.any():
        raise SourceError(path, f"no frame is whole: {reason}; `fill_gap_frames` closes longer gaps")
    most = max(gap.frames for gap in blamed)
    return (
        f"{np.count_nonzero(~valid)} of {len(valid)} source frames are invalid and have no word; {reason}; "
        f"`fill_gap_frames: {most}` closes all gaps along straight lines; `kinedex stabilise` fills them by the motion "
        "around them and by what the archive knows"
    )


def _gaps_in_words(gaps: list[Gap], names: list[str], most: int = 6) -> str:
    """List points with the frames of their gaps, by descending number of frames, and the number of further points."""
    frames: dict[str, list[int]] = {}
    for gap in gaps:
        frames.setdefault(names[gap.point], []).append(gap.frames)
    worst = sorted(frames.items(), key=lambda item: -sum(item[1]))
    shown = [f"{name} {sum(counts)} frames (longest {max(counts)})" for name, counts in worst[:most]]
    return ", ".join(shown) + (f" and {len(worst) - most} more points" if len(worst) > most else "")


def root_orientation(positions: F64, joints: tuple[str, ...], valid: Mask, warnings: list[str]) -> F64:
    """Estimate the root's orientation from hips and spine: X from the right hip to the left, Y up the spine.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres.
    joints : tuple of str
        The names of the J joints.
    valid : bool array (T,)
        The frames in which the known joints are finite.
    warnings : list of str
        A sentence is appended if the orientation cannot be estimated.

    Returns
    -------
    float64 array (4, T)
        Unit quaternions w, x, y, z; NaN in invalid frames, and in all frames where hips or spine are unknown or have
        no length.
    """
    part = slice(None) if valid.all() else valid
    wanted = ("lhip", "rhip", "root", *_SPINE)
    places = {joint: positions[i][:, part] for i, joint in enumerate(joints) if joint in wanted}
    orientation = np.full((4, positions.shape[2]), np.nan)
    spine = next((name for name in _SPINE if name in places and np.isfinite(places[name]).all()), None)
    if spine is not None and {"lhip", "rhip", "root"} <= set(places):
        matrices = kinematics.frames_along(places["lhip"] - places["rhip"], places[spine] - places["root"])
        if np.isfinite(matrices).all():
            orientation[:, valid] = kinematics.quaternions(matrices)
            return orientation
    warnings.append(
        "hips or spine are unknown or without length, so the root's turn is too: features of it are unknown"
    )
    return orientation
