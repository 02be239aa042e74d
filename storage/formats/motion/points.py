"""Convert points over time, such as joint positions and markers, to a body, as the readers of many formats do.

Short gaps are filled by linear interpolation, and hidden markers by the pose of their segment; frames in other gaps are
invalid.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple, Self, TypeVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.capture_sessions import BY_SESSION, NO_RATE, OPEN_UP
from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.catalog.skeletons.recognition.recognised_tree import joint_positions
from kinedex.catalog.skeletons.skeleton_fit import Fit, axes_of_up
from kinedex.ops.body import kinematics
from kinedex.ops.body.resample import Gap
from kinedex.ops.body.up_axis import up_axis
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.hidden_markers import Closed, close_gaps, largest_error
from kinedex.storage.formats.motion.mapped_body import (
    recognition_evidence,
    recognition_warnings,
    refuse_far,
    to_metres,
    unit_statement,
)
from kinedex.storage.formats.motion.reader import (
    FASTEST_HZ,
    SLOWEST_HZ,
    Body,
    Extent,
    MotionFile,
    Reader,
    ReadSettings,
    body_bytes,
)
from kinedex.storage.formats.motion.replaced_joints import replaced_joints
from kinedex.storage.formats.motion.static_trials import StaticTrial, added_markers, labels_as_in, static_shapes

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

_BLOCK_FRAMES = 16_384  # frames at once: some 10 MB of joints
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
    static : StaticTrial, optional
        The static trial that completes the points (`completed`).
    """

    path: str
    names: tuple[str, ...]
    positions: F64
    rate_hz: float | None = None
    clock_hz: float | None = None
    unit_m: float | None = None
    warnings: list[str] = field(default_factory=list)
    static: StaticTrial | None = None

    def indices(self) -> dict[str, int]:
        """Return a dict from name to index."""
        return {name: i for i, name in enumerate(self.names)}

    def seen(self) -> Self:
        """Return the points that are present in at least one frame; other points would only shift the indices."""
        there = np.flatnonzero(np.isfinite(self.positions).any(axis=(1, 2)))
        if len(there) == len(self.positions):
            return self
        return replace(self, names=tuple(self.names[i] for i in there), positions=self.positions[there])


AnyPoints = TypeVar("AnyPoints", bound=Points)

_SHARED = 3  # least labels of a static trial that a motion has, too


def completed(points: AnyPoints, trial: Path | None, read: Callable[[Path], Points]) -> AnyPoints:
    """Return the points of a motion, with the markers that only its static trial has, as their segments place them.

    Parameters
    ----------
    points : Points
        The points of the motion.
    trial : Path, optional
        The file of the static trial, if the motion has one.
    read : callable
        Reads the points of such a file.
    """
    if trial is None:
        return points
    try:
        static = read(trial).seen()
    except SourceError as fault:
        reason = f"its static trial {trial.name} cannot be read, and places no markers: {fault.reason}"
        return replace(points, warnings=[*points.warnings, reason])
    labels = labels_as_in(static.names, points.names)
    if len(set(labels) & set(points.names)) < _SHARED or len(set(labels)) < len(labels):
        return points
    scale = static.unit_m / points.unit_m if static.unit_m and points.unit_m else 1.0
    motion = dict(zip(points.names, points.positions, strict=True))
    tolerance = largest_error(points.positions)
    shapes = static_shapes(labels, scale * static.positions, motion, tolerance)
    added = added_markers(points.names, points.positions, shapes, tolerance)
    warnings = [added.refusal(trial.name)] if added.refused else []
    return replace(
        points,
        names=(*points.names, *added.positions),
        positions=np.concatenate([points.positions, *(track[None] for track in added.positions.values())]),
        warnings=[*points.warnings, *warnings],
        static=StaticTrial(trial.name, shapes, added.markers),
    )


def points_bytes(frames: int, points: int, joints: int) -> int:
    """Estimate the memory in bytes of points, of the body made of them, and of intermediate arrays."""
    masks, gaps = 4 * 3 * points * frames, 100 * frames
    return 24 * points * frames + masks + gaps + body_bytes(frames, joints) + min(frames, _BLOCK_FRAMES) * 96 * joints


def trial_bytes(trial: Path | None, size: Callable[[MotionFile], tuple[int, int, int]]) -> int:
    """Estimate the memory in bytes of a static trial, given a function for frames, points and further bytes."""
    try:
        frames, points, more = size(MotionFile(trial)) if trial is not None else (0, 0, 0)
    except SourceError:  # the motion is read without it
        return 0
    return 2 * 24 * frames * points + more


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
    closed = _closed(points, used, longest, fit.recognised)
    positions = _placed(points.positions, fit, joints)
    known = [i for i, joint in enumerate(joints) if joint not in fit.unknown]
    valid: Mask = np.ones(positions.shape[2], np.bool_)
    for i in known:
        valid &= np.logical_not(np.isnan(positions[i]).any(axis=0))
    called = [names[index] for index in used]
    if closed.lines:
        warnings.append(f"gaps closed along straight lines: {_gaps_in_words(closed.lines, called)}")
    warnings += closed.warnings(names, points.static.name if points.static is not None else "")
    if not valid.all():
        lost = [joints[i] for i in known if np.isnan(positions[i]).any()]
        warnings.append(_invalid(path, fit, valid, closed.left, longest, called, lost))
    first = int(np.argmax(valid))
    stated = unit_statement(fit, points.unit_m, settings)
    evidence = list(recognition_evidence(fit))
    unit = to_metres(path, positions, stated, joints, warnings, evidence, first)
    refuse_far(path, positions, joints, fit.unknown, valid)
    replaced = replaced_joints(points.positions, fit, positions, joints, float(unit.split()[0]))
    warnings += replaced.warnings
    estimated = dict(fit.estimated)
    for joint, how in replaced.estimated.items():
        estimated.setdefault(joint, how)
    if how := ", ".join(f"{joint} ({estimated[joint]})" for joint in estimated if joint not in fit.estimated):
        evidence.append(f"joints whose points are hidden for long are estimated: {how}")
    return Body(
        positions=positions,
        orientation=root_orientation(positions, joints, valid, warnings),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        up=fit.up,
        unknown=fit.unknown,
        warnings=tuple(warnings),
        valid=None if valid.all() else valid,
        estimated=tuple(estimated),
        confidence=fit.confidence,
        evidence=tuple(evidence),
        filled_frames=closed.frames,
        filled_from=closed.least,
    )


def _closed(points: Points, used: list[int], longest: int, recognised: bool) -> Closed:
    """Close gaps of the used points in place, and count those that the static trial has added."""
    static = points.static
    shapes = static.shapes if static is not None else {}
    closed = close_gaps(points.positions, used, longest, points.names if recognised else None, shapes)
    index = points.indices()
    for label, counts in static.markers.items() if static is not None else ():
        if index[label] in used:
            closed.by_static[index[label]] = counts
    return closed


def _rate(points: Points, settings: ReadSettings, warnings: list[str]) -> float:
    """Return the rate to use; append a warning if the file contradicts itself or the user."""
    if points.rate_hz is not None:
        rate_hz = settings.rate_of(points.rate_hz, warnings)
    elif (set_hz := settings.override_rate_hz or settings.rate_hz) is not None:
        rate_hz = set_hz
    elif points.clock_hz is not None and SLOWEST_HZ <= points.clock_hz <= FASTEST_HZ:
        rate_hz = points.clock_hz
    elif settings.session_hz is not None:
        rate_hz = settings.session_hz
        warnings.append(f"{NO_RATE}: {rate_hz:g} Hz is taken, {BY_SESSION}; if you know it, give --rate HZ")
    else:
        raise SourceError(points.path, f"{NO_RATE.removeprefix('it ')}: give `rate_hz`, or --rate")
    if points.clock_hz is not None and abs(points.clock_hz - rate_hz) > 0.01 * rate_hz:
        warnings.append(f"it is read at {rate_hz:.6g} Hz, but by the times in the file it is {points.clock_hz:.6g} Hz")
    return rate_hz


def _placed(points: F64, fit: Fit, joints: tuple[str, ...]) -> F64:
    """Return the named joints (J, 3, T), built in blocks of frames."""
    frames = points.shape[2]
    positions = np.empty((len(joints), 3, frames))
    for start in range(0, frames, _BLOCK_FRAMES):
        stop = start + _BLOCK_FRAMES
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


SURE_UP = 0.75
"""The confidence from which a body is rotated upright, or the file's up axis is doubted."""


class FittedPoints(NamedTuple):
    """The points of a file with the mapping that fits them, and warnings about both."""

    points: Points
    fit: Fit
    warnings: list[str]


class PointsReader(Reader):
    """A reader of files that hold points by name; subclasses define `points`, `size` and optionally `persons`.

    Attributes
    ----------
    up : str, optional
        The axis that is vertical in all files of the format.
    """

    format: ClassVar[Format] = "positions"
    up: ClassVar[str | None] = None

    @abstractmethod
    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Return the points of a file, or of the chosen person.

        Raises
        ------
        SourceError
            The file is damaged, or holds no points.
        """

    @abstractmethod
    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return frames and points of a file, and the bytes of memory for reading besides those of the points.

        Raises
        ------
        SourceError
            The file cannot be read.
        """

    def named(self, points: Points, mappings: Mappings) -> Points:
        """Return the points with a name for each; by default they have names."""
        return points

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates and the longest gap, the settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz, settings.fill_gap_frames

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the number of frames, and the estimated memory for all points and the body computed from them."""
        frames, points, more = self.size(file)
        more += trial_bytes(file.skeleton, self.size)
        return Extent(frames, points_bytes(frames, points, joints) + more, settings.override_rate_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read the points of a file, recognise the body, and build its joints.

        Raises
        ------
        SourceError
            The file is damaged, the body is not recognised, no frame is complete, or no rate is known.
        """
        points, fit, warnings = self.fitted(file, mappings, settings)
        return body_of_points(points, points.names, fit, joints, settings, warnings)

    def fitted(self, file: MotionFile, mappings: Mappings, settings: ReadSettings) -> FittedPoints:
        """Read the points of a file, and recognise the body.

        Raises
        ------
        SourceError
            The file is damaged, or the body is not recognised.
        """
        points = self.named(self.points(file, settings), mappings).seen()
        points = completed(points, file.skeleton, lambda trial: self._of_trial(trial, file.person, mappings, settings))
        evidence = evidence_of(points, self.up)
        fit = mappings.detect(file.path, "positions", points.indices(), evidence)
        warnings = [*points.warnings, *recognition_warnings(fit)]
        if "positions" not in mappings.forced:
            fit = upright(fit, evidence, warnings, settings.session_up)
        return FittedPoints(points, fit, warnings)

    def _of_trial(self, trial: Path, person: str, mappings: Mappings, settings: ReadSettings) -> Points:
        """Return the points of a static trial, those of the same person if it has several."""
        chosen = person if person in self.persons(MotionFile(trial), mappings) else ""
        return self.named(self.points(MotionFile(trial, person=chosen), settings), mappings)


def evidence_of(points: Points, up: str | None = None) -> Evidence:
    """Return the evidence for recognising a body: the points in some frames.

    Parameters
    ----------
    points : Points
        The points of a file.
    up : str, optional
        The axis that the file states as vertical.
    """
    frames = points.positions.shape[2]
    sample = np.unique(np.linspace(0, frames - 1, min(frames, SAMPLED_FRAMES)).astype(int))
    return Evidence(points.names, points.positions[:, :, sample], up=up, unit_m=points.unit_m)


def upright(fit: Fit, evidence: Evidence, warnings: list[str], session_up: str = "") -> Fit:
    """Return the fit rotated upright if no up axis is stated; warn if the body contradicts the stated axis.

    Parameters
    ----------
    fit : Fit
        The mapping over the points.
    evidence : Evidence
        The points in some frames, and the axis that the file states as vertical.
    warnings : list of str
        A sentence is appended if the body stands along another axis than the file states, or if no axis is stated and
        none is clearly up.
    session_up : str, optional
        The vertical axis of the other files of the folder, which counts where no axis is clearly up.
    """
    if fit.mapping.unit_m is not None and evidence.up is None:
        return fit  # the mapping of a single archive states its axes
    judged = up_axis(joint_positions(fit, evidence.positions, None)[0])
    taken = fit.up
    if evidence.up is None and judged.axis != taken and judged.confidence < SURE_UP:
        by_session = f", {BY_SESSION}" if session_up else ""
        warnings.append(f"{OPEN_UP} ({'; '.join(judged.reasons)}): {session_up or taken} is taken{by_session}")
        turned = session_up not in ("", taken)
        return replace(fit, mapping=replace(fit.mapping, axes=axes_of_up(session_up))) if turned else fit
    if not judged.axis or judged.axis == taken or judged.confidence < SURE_UP:
        return fit
    if evidence.up is not None:
        warnings.append(
            f"the file states that {taken} is up, which counts, but its body stands along {judged.axis} "
            f"({judged.reasons[0]}); if it lies on its side, give a mapping of your own with `up` and `screen: false`"
        )
        return fit
    reasons = (*fit.reasons, f"{judged.axis} is up: " + "; ".join(judged.reasons))
    return replace(fit, mapping=replace(fit.mapping, axes=axes_of_up(judged.axis)), reasons=reasons)
