"""This module calibrates sensors on limbs: the mount q_L of each sensor and the inertial world q_G (thesis, 7.5).

The model is q_I = q̄_G ∘ q_T ∘ q_L (Eq. 7.5), with the rotations q_I: sensor → inertial world, q_T: segment → the take's
world, q_L: sensor → segment, and q_G: inertial world → the take's world. The thesis solves it by the method of Park and
Martin (Eqs. 7.9 to 7.14), which is not robust to wrong frames. This module chooses the best of many hypotheses from few
frames (`hypotheses`), followed by reweighted fits, in which wrong frames lose their weight. A fit needs one pass over
the frames: the sum of w · (q_Gᵀ A q_L)², with a 4 × 4 matrix A for each frame, depends on the frames only by 136 sums.

The calibration also measures how well a take's movements determine a sensor's mount. It corrects heading drift, a slow
rotation about the vertical of the orientations of a sensor without a magnetometer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.hypotheses import UPRIGHT, Unit, best_world, world_guesses, worlds_of_mount
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, matrix, multiply, rotate, row

KNOT_S = 20.0
ROUNDS = 8
SCALE_DEG, FARTHEST_DEG = 6.0, 25.0


SCALES_DEG = (12.0, 6.0, 6.0, 6.0, 6.0, 6.0, 6.0)
"""The scale s of each reweighted fit: the error at which a frame has a quarter of its weight, w = (s²/(s² + e²))²."""

STILL_DEG, MAX_STEPS = 1e-6, 30
DRIFT_ROUNDS = 3
INLIER_DEG = 15.0

REFUSED, DOUBTFUL = 0.002, 0.02
"""Eigenvalues below which a mount is refused, and below which it is doubtful."""

TILTED_DEG, FEW = 3.0, 0.4
"""Thresholds for a warning: the largest tilt of q_G in degrees, and the smallest fraction of frames that fit."""


@dataclass(frozen=True)
class HeadingDrift:
    """A piecewise linear curve of the rotation about Z in degrees that corrects a sensor's orientations.

    Attributes
    ----------
    times : float64 array (K,)
        The knots in seconds of the take; without knots there is no correction.
    degrees : float64 array (K,)
        The rotation at each knot.
    """

    times: F64
    degrees: F64

    @classmethod
    def none(cls) -> HeadingDrift:
        """Return the curve without any correction."""
        return cls(np.empty(0), np.empty(0))

    def at(self, times: F64) -> F64:
        """Return the corrections (T,) in degrees at times of the take, constant beyond the first and last knot."""
        return np.interp(times, self.times, self.degrees) if len(self.times) else np.zeros(len(times))

    def corrected(self, times: F64, sensor: F64) -> F64:
        """Return the orientations (T, 4) of the sensor in F_GI, with the drift removed."""
        return multiply(self._turns(times), sensor) if len(self.times) else sensor

    def uncorrected(self, times: F64, sensor: F64) -> F64:
        """Return orientations (T, 4) as a sensor with this drift would report them."""
        return multiply(conjugate(self._turns(times)), sensor) if len(self.times) else sensor

    def _turns(self, times: F64) -> F64:
        return exp(np.radians(self.at(times))[:, None] * np.array([0.0, 0.0, 1.0]))


def heading_deg(sensor: F64, track: F64, q_global: F64, q_mount: F64) -> F64:
    """Return the heading error (T,) of the sensor's orientations in degrees, −180 to 180.

    It is 2·atan2(z, w) of the quaternion q̄_G ∘ q_T ∘ q_L ∘ q̄_I (global, track, mount, sensor).
    """
    turn = multiply(multiply(multiply(conjugate(q_global), track), q_mount), conjugate(sensor))
    heading = np.degrees(2.0 * np.arctan2(turn[:, 3], turn[:, 0]))
    return 180.0 - (180.0 - heading) % 360.0


def fit_drift(times: F64, headings: F64) -> HeadingDrift:
    """Fit a piecewise linear curve to heading errors by reweighted least squares, so that wrong frames lose influence.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the take in seconds, ascending.
    headings : float64 array (T,)
        Heading errors in degrees, see `heading_deg`. Values beyond 25° are ignored.

    Returns
    -------
    HeadingDrift
        Knots every 20 s, at least two; no correction if all headings are ignored.
    """
    near = np.abs(headings) <= FARTHEST_DEG
    if not near.any() or not times[-1] > times[0]:
        return HeadingDrift.none()
    knots = np.linspace(times[0], times[-1], max(2, math.ceil((times[-1] - times[0]) / KNOT_S) + 1))
    times, headings = times[near], headings[near]
    left = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    share = (times - knots[left]) / (knots[1] - knots[0])
    # a small stiffness interpolates over knots without frames nearby
    bend = np.diff(np.eye(len(knots)), 2, axis=0)
    stiff = 1e-6 * len(times) * (bend.T @ bend)
    weights = np.ones(len(times))
    values = np.zeros(len(knots))
    for _ in range(ROUNDS):
        values = _weighted(left, share, headings, weights, stiff)
        residual = headings - (values[left] * (1.0 - share) + values[left + 1] * share)
        weights = (SCALE_DEG**2 / (SCALE_DEG**2 + residual**2)) ** 2
    return HeadingDrift(knots, values)


def _weighted(left: I64, share: F64, headings: F64, weights: F64, stiff: F64) -> F64:
    """Return the headings at the curve's knots, by weighted least squares."""
    count = len(stiff)
    hessian = stiff + 1e-12 * np.eye(count)
    gradient = np.zeros(count)
    for first, own in ((0, 1.0 - share), (1, share)):
        gradient += np.bincount(left + first, weights * own * headings, count)
        for second, other in ((0, 1.0 - share), (1, share)):
            sums = np.bincount(left, weights * own * other, count - 1)
            hessian[np.arange(count - 1) + first, np.arange(count - 1) + second] += sums
    return np.asarray(np.linalg.solve(hessian, gradient), np.float64)


@dataclass(frozen=True)
class Stream:
    """The orientations of a sensor in a recording, with those of the limb that wears the sensor.

    Attributes
    ----------
    limb : str
        Streams of the same limb share the mount q_L.
    take : str
        The take, for messages.
    times : float64 array (T,)
        Times of the frames in seconds of the take.
    sensor : float64 array (T, 4)
        Orientations of the sensor at these times, sensor → F_GI; NaN where unknown.
    track : float64 array (T, 4)
        Orientations of the limb, segment → the take's world; NaN where unknown.
    valid : bool array (T,)
        The frames that may be fitted.
    """

    limb: str
    take: str
    times: F64
    sensor: F64
    track: F64
    valid: Bool

    def __post_init__(self) -> None:
        count = len(self.times)
        shapes = (self.sensor.shape, self.track.shape, self.valid.shape)
        if shapes != ((count, 4), (count, 4), (count,)):
            raise ParameterError("sensor, track and valid", f"of shapes ({count}, 4), ({count}, 4), ({count},)", shapes)


@dataclass(frozen=True)
class Options:
    """The assumptions of a calibration.

    Attributes
    ----------
    shared : bool
        True if all streams have the same inertial world q_G, which needs magnetometers; False to fit one per stream.
    vertical_known : bool
        True if the take's Y axis is vertical, so that q_G is known except for a rotation about it; False to fit all of
        q_G.
    drift : bool
        True to correct a slow drift of the heading of each stream.
    seed : int
        The seed of the random hypotheses.
    """

    shared: bool = True
    vertical_known: bool = True
    drift: bool = False
    seed: int = 0


@dataclass(frozen=True)
class StreamFit:
    """The calibration of a stream, with measures of its quality.

    Attributes
    ----------
    q_global, q_mount : float64 array (4,)
        F_GI → the take's world, and sensor → segment.
    drift : HeadingDrift
        The correction of the sensor's heading.
    frames : int
        The frames that were fitted.
    inliers : float
        The fraction of these frames with an error below 15°.
    median_deg : float
        The median error in degrees of the frames with an error below 15°.
    observability : float
        The smallest eigenvalue of the normal matrix of q_G and q_L; 0 if a rotation is undetermined.
    tilt_deg : float
        The angle in degrees between the vertical axes of the inertial world and of the take; 0 if the vertical is
        known.
    refused : str
        The reason why the mount cannot be determined; empty if it can.
    warning : str
        The reason why the result is doubtful; empty if it is not.
    """

    q_global: F64
    q_mount: F64
    drift: HeadingDrift
    frames: int
    inliers: float
    median_deg: float
    observability: float
    tilt_deg: float
    refused: str
    warning: str


class _Fit(NamedTuple):
    """The result of a fit: q_G of each world (G, 4), q_L of each mount (M, 4), and the weight of each frame."""

    worlds: F64
    mounts: F64
    weights: list[F64]


class _Held(NamedTuple):
    """Rotations that are given and not fitted: q_G of all streams, and q_L by the index of the mount."""

    world: F64 | None
    mounts: Mapping[int, F64]


def calibrate(
    streams: Sequence[Stream],
    options: Options = Options(),
    *,
    mounts: Mapping[str, F64] | None = None,
    world: F64 | None = None,
) -> list[StreamFit]:
    """Find the mounts and the inertial worlds of the streams of one session of wearing sensors.

    Parameters
    ----------
    streams : sequence of Stream
        The streams of all takes of a session, or of one take. Streams of one limb share q_L.
    options : Options
        The assumptions.
    mounts : mapping of str to float64 array (4,), optional
        Known values of q_L by limb, from another take; q_L of other limbs is fitted.
    world : float64 array (4,), optional
        Known value of q_G, from another take; only allowed with `shared`.

    Returns
    -------
    list of StreamFit
        The fit of each stream; `refused` is set if the movements do not determine the mount.

    Raises
    ------
    ParameterError
        There is no stream, `world` is given without `shared`, or a stream has no frame that may be fitted.
    """
    if not streams:
        raise ParameterError("streams", "one or more", "none")
    if world is not None and not options.shared:
        raise ParameterError("world", "None where every stream has its own inertial world", world.tolist())
    limbs = sorted({stream.limb for stream in streams})
    held = _Held(world, {limbs.index(limb): mount for limb, mount in (mounts or {}).items() if limb in limbs})
    known = [_known_frames(stream) for stream in streams]
    drifts = [HeadingDrift.none() for _ in streams]
    rounds = DRIFT_ROUNDS if options.drift else 1
    for _ in range(rounds):
        parts = [
            (drift.corrected(stream.times[frames], stream.sensor[frames]), stream.track[frames])
            for stream, frames, drift in zip(streams, known, drifts, strict=True)
        ]
        units, unit_of = _units(streams, parts, limbs, options.shared)
        fit = _reweighted(units, _start(units, options, held), options.vertical_known, held)
        if options.drift:
            drifts = [
                _drift_on_top(drifts[s], stream.times[known[s]], parts[s], fit, units[unit_of[s]])
                for s, stream in enumerate(streams)
            ]
    return _results(streams, known, drifts, units, unit_of, fit, options, held)


def _known_frames(stream: Stream) -> I64:
    """Return the frames of a stream that may be fitted."""
    finite = np.isfinite(stream.sensor).all(axis=1) & np.isfinite(stream.track).all(axis=1)
    frames = np.flatnonzero(stream.valid & finite)
    if not len(frames):
        raise ParameterError(
            f"{stream.take}: {stream.limb}", "known by take and sensor together in some frame", "no such frame"
        )
    return frames


def _units(
    streams: Sequence[Stream], parts: Sequence[tuple[F64, F64]], limbs: Sequence[str], shared: bool
) -> tuple[list[Unit], list[int]]:
    """Concatenate the frames of streams with the same mount and world; also return the unit of each stream."""
    keys = [(limbs.index(stream.limb), 0 if shared else s) for s, stream in enumerate(streams)]
    units = []
    for key in sorted(set(keys)):
        own = [part for part, other in zip(parts, keys, strict=True) if other == key]
        sensor, track = (np.ascontiguousarray(np.concatenate(rows), np.float64) for rows in zip(*own, strict=True))
        units.append(Unit(sensor, track, *key))
    return units, [sorted(set(keys)).index(key) for key in keys]


def _start(units: Sequence[Unit], options: Options, held: _Held) -> _Fit:
    """Find initial values of q_G for each world and q_L for each mount, as the best of many hypotheses."""
    spread = [unit.spread() for unit in units]
    worlds = np.tile([1.0, 0.0, 0.0, 0.0], (1 + max(unit.world for unit in units), 1))
    mounts = np.tile([1.0, 0.0, 0.0, 0.0], (1 + max(unit.mount for unit in units), 1))
    for mount, value in held.mounts.items():
        mounts[mount] = value
    for world in sorted({unit.world for unit in units}):
        members = [i for i, unit in enumerate(units) if unit.world == world]
        given = [held.mounts.get(units[i].mount) for i in members]
        guesses = _guesses([spread[i] for i in members], given, options, held.world)
        sizes = [len(units[i].sensor) for i in members]
        worlds[world], found, _ = best_world([spread[i] for i in members], sizes, guesses, given)
        for i, mount in zip(members, found, strict=True):
            mounts[units[i].mount] = mount
    if not options.shared:
        _reconcile(units, spread, worlds, mounts, options, held)
    return _Fit(worlds, mounts, [])


def _guesses(units: Sequence[Unit], given: Sequence[F64 | None], options: Options, world: F64 | None) -> F64:
    """Return hypotheses (C, 4) of one q_G from all units that share it."""
    if world is not None:
        return world[None]
    parts = [
        world_guesses(unit, options.vertical_known, options.seed)
        if mount is None
        else worlds_of_mount(unit, mount, options.vertical_known)
        for unit, mount in zip(units, given, strict=True)
    ]
    guesses = np.unique(np.concatenate(parts), axis=0)
    # without rotations about two axes the limbs are refused later; any world serves until then
    return guesses if len(guesses) else UPRIGHT[:1]


def _reconcile(
    units: Sequence[Unit], spread: Sequence[Unit], worlds: F64, mounts: F64, options: Options, held: _Held
) -> None:
    """Choose one mount for units that share it but have different worlds: the one of lowest total cost."""
    for mount in range(len(mounts)):
        members = [i for i, unit in enumerate(units) if unit.mount == mount]
        if len(members) < 2 or mount in held.mounts:
            continue
        least = math.inf
        for i in members:
            # the mount that this unit alone would give
            _, (guess,), _ = best_world([spread[i]], [1], worlds[units[i].world][None], [None])
            found = [
                best_world(
                    [spread[j]],
                    [len(units[j].sensor)],
                    worlds_of_mount(spread[j], guess, options.vertical_known),
                    [guess],
                )
                for j in members
            ]
            cost = sum(cost for *_, cost in found)
            if cost < least:
                least, mounts[mount] = cost, guess
                for j, (world, *_) in zip(members, found, strict=True):
                    worlds[units[j].world] = world


def _reweighted(units: Sequence[Unit], start: _Fit, vertical_known: bool, held: _Held) -> _Fit:
    """Refit all rotations repeatedly, with weights from the errors of the previous fit."""
    worlds, mounts = start.worlds.copy(), start.mounts.copy()
    weights = [np.empty(len(unit.sensor)) for unit in units]
    for scale in SCALES_DEG:
        sums = np.empty((len(units), 16, 16))
        for i, unit in enumerate(units):
            _sums(unit.sensor, unit.track, worlds[unit.world], mounts[unit.mount], scale, weights[i], sums[i])
        _alternate(units, sums, worlds, mounts, vertical_known, held)
    return _Fit(worlds, mounts, weights)


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(sensor: F64, track: F64, world: F64, mount: F64, scale_deg: float, weights: F64, out: F64) -> None:
    """Sum w A ⊗ A over frames, with q_Gᵀ A q_L the real part of the rotation between q_G ∘ q_I and q_T ∘ q_L."""
    degrees = 2.0 * 180.0 / math.pi
    square = scale_deg * scale_deg
    upper = np.zeros((16, 16))
    own = np.empty(16)
    for k in range(len(sensor)):
        a, b, c, d = row(sensor, k)
        w, x, y, z = row(track, k)
        # the derivatives of q_G ∘ q_I by the components of q_G, and of q_T ∘ q_L by those of q_L
        left = ((a, b, c, d), (-b, a, -d, c), (-c, d, a, -b), (-d, -c, b, a))
        right = ((w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w))
        for i in range(4):
            p = left[i]
            for j in range(4):
                q = right[j]
                own[4 * i + j] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
        cosine = 0.0
        for i in range(4):
            for j in range(4):
                cosine += world[i] * own[4 * i + j] * mount[j]
        error = degrees * math.acos(min(abs(cosine), 1.0))
        weight = square / (square + error * error)
        weight *= weight
        weights[k] = weight
        for i in range(16):
            scaled = weight * own[i]
            for j in range(i, 16):
                upper[i, j] += scaled * own[j]
    for i in range(16):
        for j in range(i, 16):
            out[i, j] = upper[i, j]
            out[j, i] = upper[i, j]


def _alternate(units: Sequence[Unit], sums: F64, worlds: F64, mounts: F64, vertical_known: bool, held: _Held) -> None:
    """Fit q_G and q_L alternately, each as the first eigenvector with the other one fixed, until q_L converges."""
    # (i, j), (k, l) → (i, k), (j, l): one product with the other rotation's squares then gives a 4 × 4 matrix
    by_mount = sums.reshape(-1, 4, 4, 4, 4).transpose(0, 1, 3, 2, 4).reshape(-1, 16, 16)
    by_world = np.ascontiguousarray(by_mount.transpose(0, 2, 1))
    world_of = np.array([unit.world for unit in units])
    mount_of = np.array([unit.mount for unit in units])
    free = np.array([mount not in held.mounts for mount in range(len(mounts))])
    for _ in range(MAX_STEPS):
        if held.world is None:
            worlds[:] = _first_eigenvectors(by_mount, mounts[mount_of], world_of, len(worlds), vertical_known)
        found = _first_eigenvectors(by_world, worlds[world_of], mount_of, len(mounts), False)
        moved = distance_deg(mounts, found)[free]
        mounts[free] = found[free]
        if not (moved > STILL_DEG).any():
            break


def _first_eigenvectors(sums: F64, others: F64, group: I64, groups: int, upright: bool) -> F64:
    """Return the first eigenvectors (groups, 4) of the units' matrices, summed by group.

    If `upright`, they are restricted to the plane `UPRIGHT`.
    """
    squares = (others[:, :, None] * others[:, None, :]).reshape(-1, 16, 1)
    each = (sums @ squares).reshape(-1, 4, 4)
    total = np.zeros((groups, 4, 4))
    np.add.at(total, group, each)
    if upright:
        return np.linalg.eigh(UPRIGHT @ total @ UPRIGHT.T)[1][:, :, -1] @ UPRIGHT
    return np.linalg.eigh(total)[1][:, :, -1]


def _drift_on_top(drift: HeadingDrift, times: F64, part: tuple[F64, F64], fit: _Fit, unit: Unit) -> HeadingDrift:
    """Return the drift of a stream plus the drift that remains after its correction."""
    left = fit_drift(times, heading_deg(*part, fit.worlds[unit.world], fit.mounts[unit.mount]))
    if not len(left.times) or not len(drift.times):
        return left if len(left.times) else drift
    return HeadingDrift(left.times, left.degrees + drift.at(left.times))


def _results(
    streams: Sequence[Stream],
    known: Sequence[I64],
    drifts: Sequence[HeadingDrift],
    units: Sequence[Unit],
    unit_of: Sequence[int],
    fit: _Fit,
    options: Options,
    held: _Held,
) -> list[StreamFit]:
    """Return the fit of each stream: its errors, and whether its movements determine the mount."""
    takes = {limb: {stream.take for stream in streams if stream.limb == limb} for limb in {s.limb for s in streams}}
    values = least_eigenvalues(units, fit.worlds, fit.weights, options.vertical_known)
    level = least_eigenvalues(units, fit.worlds, fit.weights, True)
    results = []
    for s, stream in enumerate(streams):
        unit = units[unit_of[s]]
        world, mount = fit.worlds[unit.world], fit.mounts[unit.mount]
        frames = known[s]
        sensor = drifts[s].corrected(stream.times[frames], stream.sensor[frames])
        degrees = distance_deg(multiply(world, sensor), multiply(stream.track[frames], mount))
        near = degrees < INLIER_DEG
        own = 1.0 if unit.mount in held.mounts or held.world is not None else values[unit.mount]
        shared = max(values[other.mount] for other in units if other.world == unit.world)
        tilt = 0.0 if options.vertical_known else _tilt_deg(world)
        several = len(takes[stream.limb]) > 1
        results.append(
            StreamFit(
                q_global=world,
                q_mount=mount,
                drift=drifts[s],
                frames=len(frames),
                inliers=float(near.mean()),
                median_deg=float(np.median(degrees[near])) if near.any() else math.nan,
                observability=own,
                tilt_deg=tilt,
                refused=refusal(stream.limb, max(own, shared), level[unit.mount], options.vertical_known, several),
                warning=warning(stream.limb, max(own, shared), tilt, float(near.mean())),
            )
        )
    return results


def _tilt_deg(world: F64) -> float:
    """Return the angle in degrees between the inertial world's vertical and the take's."""
    up = rotate(world, np.array([0.0, 0.0, 1.0]))
    return math.degrees(math.atan2(math.hypot(float(up[0]), float(up[2])), float(up[1])))


def least_eigenvalues(units: Sequence[Unit], worlds: F64, weights: Sequence[F64], vertical_known: bool) -> list[float]:
    """Compute the smallest eigenvalue of each mount's normal matrix, divided by the weights' sum.

    The unknowns are small rotations of q_L and of each q_G of the mount's units; the row of a frame is
    [R(q̄_T ∘ q_G), −1]. With a single q_G, the eigenvalue is 1 − |M|₂, where M is the weighted mean of R(q̄_T ∘ q_G); if
    the vertical is known, it is 1 − |M z|.

    Parameters
    ----------
    units : sequence of Unit
        All frames of the calibration.
    worlds : float64 array (G, 4)
        q_G of each world.
    weights : sequence of float64 array (n,)
        The weights of each unit's frames.
    vertical_known : bool
        True if q_G can only rotate about Z.

    Returns
    -------
    list of float
        One value for each mount, 0 to 1; 0 where a direction is undetermined.
    """
    values = []
    for mount in range(1 + max(unit.mount for unit in units)):
        square, total = np.zeros((3, 3)), 0.0
        for unit, own in zip(units, weights, strict=True):
            if unit.mount != mount:
                continue
            mass = float(own.sum())
            mean = np.tensordot(own, matrix(multiply(conjugate(unit.track), worlds[unit.world])), 1)
            if vertical_known:
                mean = mean[:, 2:]
            square += mean @ mean.T / mass if mass > 0.0 else 0.0
            total += mass
        largest = float(np.linalg.eigvalsh(square)[-1]) / total if total > 0.0 else 1.0
        values.append(max(0.0, 1.0 - math.sqrt(max(largest, 0.0))))
    return values


def refusal(limb: str, value: float, level: float, vertical_known: bool, several: bool) -> str:
    """Return the reason to refuse a limb's mount, with remedies; empty if its movements suffice.

    Parameters
    ----------
    limb : str
        The limb's name.
    value : float
        The smallest eigenvalue of this mount, or that of another limb with the same q_G if it is larger.
    level : float
        The smallest eigenvalue with the vertical known.
    vertical_known : bool
        True if the vertical is already known.
    several : bool
        True if several takes were already calibrated together.
    """
    if value >= REFUSED:
        return ""
    about = "the vertical only" if vertical_known or level < REFUSED else "one axis only"
    ways = ["use a take with other movements"]
    if not several:
        ways.append("`from: actor`")
    if not vertical_known and level >= REFUSED:
        ways.append("`vertical: known`")
    listed = ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])}, or {ways[-1]}"
    return f"{limb}: turns about {about}, the mount cannot be found; {listed}"


def warning(limb: str, value: float, tilt_deg: float, inliers: float) -> str:
    """Return the reasons why a limb's mount is doubtful; empty if it is not.

    Parameters
    ----------
    limb : str
        The limb's name.
    value : float
        The smallest eigenvalue of this mount, or that of another limb with the same q_G if it is larger.
    tilt_deg : float
        The angle between the inertial world's vertical and the take's.
    inliers : float
        The fraction of frames with an error below 15°.
    """
    parts = []
    if value < DOUBTFUL:
        parts.append(f"hardly turns about a second axis (observability {value:.3f}), the mount is doubtful")
    if tilt_deg > TILTED_DEG:
        parts.append(f"the take's vertical is {tilt_deg:.1f}° off gravity's")
    if inliers < FEW:
        parts.append(f"only {inliers:.0%} of the frames fit: is it the sensor of this limb, and the offset right?")
    return f"{limb}: {'; '.join(parts)}" if parts else ""
