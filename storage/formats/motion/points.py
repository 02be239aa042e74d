"""Bodies from places: joint positions and markers; short gaps are closed, and frames in long ones are invalid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.body import kinematics
from kinedex.ops.body.gaps import Gap, fill_gaps
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.body import NOTHING_GIVEN, Body, Given, built, refuse_far, to_metres
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.positions import Points, parse_positions

F64 = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_SPINE = ("chest", "neck", "belly", "head")  # the first that is known says what is up for the root


def read_positions(path: Path, mappings: Mappings, joints: tuple[str, ...], given: Given = NOTHING_GIVEN) -> Body:
    """Read a file of joint positions (TRC, CSV, NPZ, NPY).

    Raises
    ------
    SourceError: file, line and column of the first fault, that no mapping fits, that no frame is whole, or that nobody
    says the rate.
    """
    points = parse_positions(path)
    names = points.names or mappings.names_in_order(path, len(points.positions))
    fit = mappings.detect(path, "positions", points.places(names))
    warnings = list(points.warnings)
    if not points.names:
        warnings.append(
            f"the file does not name its joints; they are read in the order of mapping '{fit.mapping.name}'"
        )
    warnings += built(fit)
    return _body(points, names, fit, joints, given, warnings)


def read_c3d(path: Path, mappings: Mappings, joints: tuple[str, ...], given: Given = NOTHING_GIVEN) -> Body:
    """Read the markers of a C3D file.

    Raises
    ------
    SourceError: what of the file contradicts itself, that no mapping fits, or that no frame is whole.
    """
    markers = parse_c3d(path)
    fit = mappings.detect(path, "c3d", markers.places()).upright(markers.up)
    return _body(markers, markers.names, fit, joints, given, list(markers.warnings))


def _body(
    points: Points, names: tuple[str, ...], fit: Fit, joints: tuple[str, ...], given: Given, warnings: list[str]
) -> Body:
    """The body that points make: there are no turns among them, so the root's is made of places."""
    path = Path(points.path)
    rate_hz = _rate(points, given, warnings)
    longest = given.gap_frames(rate_hz)
    taken = list(fit.nodes)
    filled, closed, left = _filled(points, taken, longest)
    positions = fit.apply(filled, joints)
    known = [i for i, joint in enumerate(joints) if joint not in fit.unknown]
    valid: Mask = np.logical_not(np.isnan(positions[known]).any(axis=(0, 1)))
    called = [names[index] for index in taken]
    if closed:
        warnings.append(f"gaps closed along straight lines: {_gaps_in_words(closed, called)}")
    if not valid.all():
        lost = [joints[i] for i in known if np.isnan(positions[i]).any()]
        warnings.append(_invalid(path, fit, valid, left, longest, called, lost))
    first = int(np.argmax(valid))
    unit = to_metres(path, positions, points.unit_m or fit.mapping.unit_m, joints, warnings, first)
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
    )


def _rate(points: Points, given: Given, warnings: list[str]) -> float:
    """The rate that counts; a warning where the file contradicts itself, or the user."""
    if points.rate_hz is not None:
        rate_hz = given.rate_of(points.rate_hz, warnings)
    elif (said := given.override_rate_hz or given.rate_hz) is not None:
        rate_hz = said
    else:
        seen = f" (by its times, {points.clock_hz:.4g} Hz)" if points.clock_hz is not None else ""
        raise SourceError(points.path, f"does not say its frames per second{seen}: give `rate_hz`, or --rate")
    if points.clock_hz is not None and abs(points.clock_hz - rate_hz) > 0.01 * rate_hz:
        warnings.append(f"it is read at {rate_hz:.6g} Hz, but by the times in the file it is {points.clock_hz:.6g} Hz")
    return rate_hz


def _filled(points: Points, taken: list[int], longest: int) -> tuple[F64, list[Gap], list[Gap]]:
    """The points with the short gaps closed of those that are taken, the gaps closed, and those left."""
    part, closed, left = fill_gaps(points.positions[taken], longest)
    if not closed:
        return points.positions, closed, left
    filled = points.positions.copy()
    filled[taken] = part
    return filled, closed, left


def _invalid(
    path: Path, fit: Fit, valid: Mask, left: list[Gap], longest: int, names: list[str], lost: list[str]
) -> str:
    """What is said of invalid frames: how many, for want of which points; an error where all are."""
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
    said = (
        f"points that the mapping '{fit.mapping.name}' takes are missing for more than {longest} frames: "
        f"{_gaps_in_words(blamed, names)}"
    )
    if not valid.any():
        raise SourceError(path, f"no frame is whole: {said}; `fill_gap_frames` closes longer gaps")
    most = max(gap.frames for gap in blamed)
    return (
        f"{np.count_nonzero(~valid)} of {len(valid)} source frames are invalid and have no word; {said}; "
        f"`fill_gap_frames: {most}` closes all gaps along straight lines"
    )


def _gaps_in_words(gaps: list[Gap], names: list[str], most: int = 6) -> str:
    """The points with most frames in gaps first, and how many there are besides."""
    frames: dict[str, list[int]] = {}
    for gap in gaps:
        frames.setdefault(names[gap.point], []).append(gap.frames)
    worst = sorted(frames.items(), key=lambda item: -sum(item[1]))
    said = [f"{name} {sum(counts)} frames (longest {max(counts)})" for name, counts in worst[:most]]
    return ", ".join(said) + (f" and {len(worst) - most} more points" if len(worst) > most else "")


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
        A sentence is appended where the orientation cannot be estimated.

    Returns
    -------
    float64 array (4, T)
        Unit quaternions w, x, y, z; NaN in invalid frames, and in all frames where hips or spine are unknown or have
        no length.
    """
    whole = positions if valid.all() else positions[:, :, valid]
    places = dict(zip(joints, whole, strict=True))
    orientation = np.full((4, positions.shape[2]), np.nan)
    spine = next((name for name in _SPINE if name in places and np.isfinite(places[name]).all()), None)
    if spine is not None and {"lhip", "rhip", "root"} <= set(places):
        matrices = kinematics.frames_along(places["lhip"] - places["rhip"], places[spine] - places["root"])
        if np.isfinite(matrices).all():
            orientation[:, valid] = kinematics.quaternions(matrices)
            return orientation
    warnings.append("hips or spine are unknown or without length, so the root's turn is too: features of it are off")
    return orientation
