"""Bodies: the named joints of one source file over time, whatever format they came in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from catalog.skeletons import Fit, Format, Mappings
from catalog.units import guess_unit
from ops import kinematics
from ops.errors import SourceError
from ops.gaps import Gap, fill_gaps
from storage.acclaim import INCH_M, RATE_HZ, Skeleton, read_amc, read_asf
from storage.bvh import Bvh, parse_bvh
from storage.positions import Points, parse_positions

F64 = npt.NDArray[np.float64]

FARTHEST_M = 100_000.0
"""No body is farther from the origin: a joint beyond this is a fault of the file."""

_SPINE = ("chest", "neck", "belly", "head")  # the first that is known says what is up for the root
_WORKED_ON = 2_000_000  # nodes times frames at once: some 50 MB of positions, whatever the file's size


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
    fill_gap_frames: the longest gap of a point that is closed along a straight line; a longer one is an error.
    """

    rate_hz: float | None = None
    override_rate_hz: float | None = None
    fill_gap_frames: int = 0

    @property
    def acclaim_hz(self) -> float:
        """The rate of Acclaim files, which never say it."""
        return self.override_rate_hz or self.rate_hz or RATE_HZ

    def rate_of(self, said_hz: float, warnings: list[str]) -> float:
        """The rate of a file that says one; a warning is added where another one counts."""
        rate_hz = self.override_rate_hz or said_hz
        if abs(rate_hz - said_hz) > 1e-3 * said_hz:
            warnings.append(f"the file says {said_hz:.6g} Hz; it is read at {rate_hz:.6g} Hz, which was given")
        return rate_hz


NOTHING_GIVEN = Given()
"""The user says nothing of the files."""


FORMS: dict[str, Format] = {
    ".amc": "acclaim", ".bvh": "bvh",
    ".trc": "positions", ".csv": "positions", ".npz": "positions", ".npy": "positions",
}  # fmt: skip
"""Endings of motion files that are read, and the format of the mappings that they are read with."""


def form_of(motion: str | Path) -> Format:
    """The format of a motion file by its ending, which must be one of `FORMS`."""
    return FORMS[Path(motion).suffix.lower()]


def read_body(
    motion: Path, asf: Path | None, mappings: Mappings, joints: tuple[str, ...], given: Given = NOTHING_GIVEN
) -> Body:
    """Read a motion file of any format, told by its ending.

    Parameters
    ----------
    asf: the skeleton of an AMC file; other formats have none. given: what the user says of its rate.

    Raises
    ------
    SourceError: file and line of the first fault.
    """
    form = form_of(motion)
    if form == "bvh":
        return read_bvh(motion, mappings, joints, given)
    if form == "positions":
        return read_positions(motion, mappings, joints, given)
    if asf is None:
        raise SourceError(motion, "an AMC file is read with its ASF skeleton; none is given")
    return read_acclaim(motion, asf, mappings, joints, given.acclaim_hz)


@lru_cache(maxsize=64)
def _skeleton(path: str, _stamp: tuple[int, int], unit_m: float) -> Skeleton:
    return read_asf(path, unit_m)


def read_acclaim(amc: Path, asf: Path, mappings: Mappings, joints: tuple[str, ...], rate_hz: float = RATE_HZ) -> Body:
    """Read an AMC file with its ASF skeleton.

    Parameters
    ----------
    joints: the named joints, in the order of the result. rate_hz: Acclaim files do not say their rate.

    Raises
    ------
    SourceError: file and line of the first fault in either file.
    """
    try:
        stat = asf.stat()
        stamp = (stat.st_size, stat.st_mtime_ns)
    except OSError:
        stamp = (0, 0)
    skeleton = _skeleton(str(asf), stamp, INCH_M)
    fit = mappings.detect(asf, "acclaim", skeleton.bones)
    if fit.mapping.unit_m not in (None, INCH_M):
        skeleton = _skeleton(str(asf), stamp, fit.mapping.unit_m)
    motion = read_amc(amc, skeleton)
    nodes, matrices = kinematics.forward(skeleton.nodes, motion.channels, wanted=fit.nodes)
    positions = fit.apply(nodes, joints)
    _refuse_far(amc, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=_orientation(fit, matrices, skeleton.root_frame),
        rate_hz=rate_hz,
        unit=f"{skeleton.unit_m / skeleton.length_scale:.6g} m",
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=(*motion.warnings, *_virtual(fit)),
    )


def read_bvh(path: Path, mappings: Mappings, joints: tuple[str, ...], given: Given = NOTHING_GIVEN) -> Body:
    """Read a BVH file, which carries its own skeleton and rate.

    Parameters
    ----------
    mappings: those that its skeleton is looked for in. joints: the named joints, in the order of the result.
    given: a rate that counts in place of the file's.

    Raises
    ------
    SourceError: file and line of the first fault, or that no mapping fits.
    """
    bvh = parse_bvh(path)
    fit = mappings.detect(path, "bvh", bvh.places)
    nodes, restored = _restore(bvh, fit)
    positions, turned = _track(nodes, bvh.channels, fit, joints)
    warnings = [*bvh.warnings, *_virtual(fit)]
    rate_hz = given.rate_of(bvh.rate_hz, warnings)
    if restored:
        warnings.append(
            f"bones {', '.join(restored)} have no length in the file; mapping '{fit.mapping.name}' gives them one"
        )
    unit = _to_metres(path, positions, fit.mapping.unit_m, joints, warnings)
    _refuse_far(path, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=_orientation(fit, turned),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=tuple(warnings),
    )


def read_positions(path: Path, mappings: Mappings, joints: tuple[str, ...], given: Given = NOTHING_GIVEN) -> Body:
    """Read a file of joint positions (TRC, CSV, NPZ, NPY).

    There are no turns in it, so the root's is made of places: X from the right hip to the left, Y up the spine.

    Raises
    ------
    SourceError: file, line and column of the first fault, that no mapping fits, that a gap is too long, or that nobody
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
    warnings += _virtual(fit)
    rate_hz = _rate(points, given, warnings)
    positions = fit.apply(_filled(points, names, fit, given.fill_gap_frames, warnings), joints)
    unit = _to_metres(path, positions, points.unit_m or fit.mapping.unit_m, joints, warnings)
    _refuse_far(path, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=_upright(positions, joints, warnings),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=tuple(warnings),
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


def _filled(points: Points, names: tuple[str, ...], fit: Fit, longest: int, warnings: list[str]) -> F64:
    """The points with short gaps closed; only those that the mapping takes matter."""
    nodes = {name for mix in fit.joints.values() if mix is not None and not mix.of_joints for name, _ in mix.weights}
    taken = sorted(fit.places[name] for name in nodes)
    part, closed, left = fill_gaps(points.positions[taken], longest)
    if left:
        first = min(left, key=lambda gap: gap.start)
        most = max(gap.frames for gap in left)
        raise SourceError(
            points.path,
            f"'{names[taken[first.point]]}' is missing in source frames {first.start} to {first.stop - 1} (gaps that "
            f"are too long: {len(left)}, the longest of {most} frames); `fill_gap_frames: {most}` closes them along "
            "straight lines, or cut the take there",
        )
    if not closed:
        return points.positions
    filled = points.positions.copy()
    filled[taken] = part
    warnings.append(f"gaps closed along straight lines: {_gaps_in_words(closed, [names[index] for index in taken])}")
    return filled


def _gaps_in_words(gaps: list[Gap], names: list[str]) -> str:
    frames: dict[str, list[int]] = {}
    for gap in gaps:
        frames.setdefault(names[gap.point], []).append(gap.frames)
    return ", ".join(f"{name} {sum(counts)} frames (longest {max(counts)})" for name, counts in frames.items())


def _upright(positions: F64, joints: tuple[str, ...], warnings: list[str]) -> F64:
    """The root's quaternion by hips and spine; NaN in all frames where one of these is unknown or has no length."""
    places = dict(zip(joints, positions, strict=True))
    spine = next((name for name in _SPINE if name in places and np.isfinite(places[name]).all()), None)
    if spine is not None and {"lhip", "rhip", "root"} <= set(places):
        matrices = kinematics.frames_along(places["lhip"] - places["rhip"], places[spine] - places["root"])
        if np.isfinite(matrices).all():
            return kinematics.quaternions(matrices)
    warnings.append("hips or spine are unknown or without length, so the root's turn is too: features of it are off")
    return np.full((4, positions.shape[2]), np.nan)


def _restore(bvh: Bvh, fit: Fit) -> tuple[tuple[kinematics.Node, ...], list[str]]:
    """The nodes with the lengths that a mapping gives to bones whose OFFSET is zero, and the names of those bones."""
    nodes, restored = list(bvh.nodes), []
    for name, weights in fit.mapping.bones.items():
        index = fit.places[name]
        moved = any(step.kind >= kinematics.MOVE_X for step in nodes[index].steps)
        if not moved and not nodes[index].before.any():
            offset = sum(weight * bvh.nodes[fit.places[other]].before for other, weight in weights.items())
            nodes[index] = replace(nodes[index], before=np.asarray(offset))
            restored.append(name)
    return tuple(nodes), restored


def _track(nodes: tuple[kinematics.Node, ...], channels: F64, fit: Fit, joints: tuple[str, ...]) -> tuple[F64, F64]:
    """Named joints (J, 3, T) in the file's unit and the root's rotation (9, T), worked on a stretch at a time."""
    frames = len(channels)
    positions, turned = np.empty((len(joints), 3, frames)), np.empty((9, frames))
    step = max(kinematics.BLOCK, _WORKED_ON // len(nodes))
    for start in range(0, frames, step):
        stop = start + step
        part, turned[:, start:stop] = kinematics.forward(nodes, channels[start:stop], fit.root, fit.nodes)
        positions[:, :, start:stop] = fit.apply(part, joints)
    return positions, turned


def _orientation(fit: Fit, turned: F64, own: F64 | None = None) -> F64:
    """The root's quaternion in our axes, from its rotations (9, T) and its own axes where it has some.

    It is the turn between the two frames' bases, seen from ours.
    """
    if "root" in fit.unknown:
        return np.full((4, turned.shape[1]), np.nan)
    root_axes = fit.mapping.root_axes.T
    return kinematics.quaternions(turned, fit.mapping.axes, root_axes if own is None else own @ root_axes)


def _virtual(fit: Fit) -> list[str]:
    built = ", ".join(f"{joint} ({mix})" for joint, mix in fit.virtual.items())
    return [f"joints that the skeleton lacks are built from others: {built}"] if built else []


def _to_metres(path: Path, positions: F64, unit_m: float | None, joints: tuple[str, ...], warnings: list[str]) -> str:
    """Turn positions into metres in place, by a unit that is known or guessed; returns the unit in words."""
    said = f"{unit_m:.6g} m" if unit_m is not None else ""
    if unit_m is None:
        name, unit_m, height = guess_unit(path, positions, joints)
        said = f"{unit_m:.6g} m (guessed)"
        warnings.append(f"its unit of length is guessed: {name}, which makes the body {height:.2f} m high")
    positions *= unit_m
    return said


def _refuse_far(path: Path, positions: F64, joints: tuple[str, ...], unknown: tuple[str, ...]) -> None:
    """Raise a SourceError where a joint is so far away that a number of the file must be wrong."""
    if positions.min() >= -FARTHEST_M and positions.max() <= FARTHEST_M:
        return
    far = ~(np.abs(positions) <= FARTHEST_M)  # a NaN is far, too: it comes of infinities
    far[[joints.index(joint) for joint in unknown]] = False
    if far.any():
        joint, _, frame = (int(at[0]) for at in np.nonzero(far))
        raise SourceError(
            path, f"joint '{joints[joint]}' is more than {FARTHEST_M / 1000:g} km away in source frame {frame}"
        )
