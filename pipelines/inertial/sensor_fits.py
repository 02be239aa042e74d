"""Calibrate the mounts of sensors on limbs: for each take, for takes that share mounts, or from one given take."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, isnan
from typing import Any

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.inertial.disagreement import mount_direction
from kinedex.ops.inertial.hand_eye import Options, Stream, StreamFit, calibrate
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.inertial.parameters import CalibrationSettings
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake, WornTakes, stream_of
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

CALIBRATION = "sensor_calibration"
"""The kind of results with a row for each sensor in each take."""

MAX_FRAMES = 100_000
"""The largest number of frames of a limb that a calibration of several takes uses, spread evenly."""

Clocks = Mapping[tuple[int, str], Clock]
"""The clock of each recording, by take_id and name of the recording."""


@dataclass(frozen=True, eq=False)
class SensorFit:
    """The calibration of one sensor in one take.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take, recording, sensor, limb, basis : str
        Names.
    fit : StreamFit or None
        The calibration; None if there is none, or if only the limb's axis is known.
    q_global : float64 array (4,) or None
        Unit quaternion (w, x, y, z) from the sensors' world F_GI to the take's world.
    direction : float64 array (3,) or None
        The limb's long axis in the sensor's axes, if only the axis is known.
    left_out : str
        The reason why there is no mount; empty if there is one.
    """

    take_id: int
    take: str
    recording: str
    sensor: str
    limb: str
    basis: str
    fit: StreamFit | None = None
    q_global: F64 | None = None
    direction: F64 | None = None
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class _Worn:
    """One sensor in one take, before its calibration."""

    take: WornTake
    sensor: WornSensor
    stream: Stream | None
    left_out: str = ""

    @property
    def limb(self) -> LimbMotion:
        return self.take.limbs[self.sensor.limb]


@dataclass(frozen=True, eq=False)
class FitTask:
    """Takes whose sensors are calibrated together, as a task for a worker.

    Attributes
    ----------
    takes : tuple of WornTake
        The takes.
    clocks : mapping of (int, str) to Clock
        The clocks of their recordings.
    params : CalibrationSettings
        The parameters of the stage.
    given : mapping of str to StreamFit or None
        The fits of limbs, by name, in the take that `from` names; None for this take itself, or if `from` names none.
    foreign : bool
        True if the sensors may be mounted differently than in the take that `from` names.
    """

    takes: tuple[WornTake, ...]
    clocks: Clocks
    params: CalibrationSettings
    given: Mapping[str, StreamFit] | None = None
    foreign: bool = False


@dataclass(frozen=True)
class FitGroups:
    """The groups of takes that are calibrated together, and the take whose mounts all others use, if there is one.

    Attributes
    ----------
    groups : tuple of (tuple of int)
        The ids of takes in each group; each take is in one group.
    source : int or None
        The id of the take that the parameter `from` names; None if it names none.
    """

    groups: tuple[tuple[int, ...], ...]
    source: int | None = None


def fit_groups(takes: WornTakes, wearing: Mapping[int, Hashable], params: CalibrationSettings) -> FitGroups:
    """Group the takes that are calibrated together: each take alone, or takes between which sensors stayed in place.

    Parameters
    ----------
    takes : WornTakes
        The takes with sensors.
    wearing : mapping of int to hashable
        The key of the takes that share sensor mounts (a "wearing"), by take_id.
    params : CalibrationSettings
        The parameters of the stage.

    Raises
    ------
    KinedexError
        `from` does not name a take with sensors.
    """
    groups: dict[Hashable, list[int]] = {}
    for take_id in takes.names:
        groups.setdefault(wearing[take_id] if params.source == "actor" else take_id, []).append(take_id)
    source = None
    if params.source not in ("take", "actor"):
        source = next((take_id for take_id, name in takes.names.items() if name == params.source), None)
        if source is None:
            raise KinedexError(
                f"from: no take with sensors is named '{params.source}'"
                f"{did_you_mean(params.source, takes.names.values())}; "
                "`take` calibrates each take by itself, `actor` all of a wearing together"
            )
    return FitGroups(tuple(map(tuple, groups.values())), source)


def fit_fingerprints(
    groups: FitGroups, wearing: Mapping[int, Hashable], prints: Mapping[int, str | None]
) -> dict[int, str | None]:
    """Return a hash of everything that determines the calibration of each take, including the takes of its group.

    Parameters
    ----------
    groups : FitGroups
        The takes that are calibrated together.
    wearing : mapping of int to hashable
        The key of the takes that share sensor mounts, by take_id.
    prints : mapping of int to (str or None)
        A hash of the data of each take; None if unknown.
    """
    found: dict[int, str | None] = {}
    for group in groups.groups:
        origins: list[object] = [prints[take_id] for take_id in group]
        if groups.source is not None:
            origins += [prints[groups.source], wearing[group[0]] == wearing[groups.source]]
        found |= dict.fromkeys(group, None if None in origins else hash_of(origins))
    return {take_id: found[take_id] for take_id in prints}


def fit_tasks(
    takes: WornTakes,
    groups: FitGroups,
    fresh: Collection[int],
    clocks: Clocks,
    wearing: Mapping[int, Hashable],
    params: CalibrationSettings,
) -> Iterator[FitTask]:
    """Yield tasks for the groups whose takes are to be calibrated.

    Parameters
    ----------
    takes : WornTakes
        The takes with sensors.
    groups : FitGroups
        The takes that are calibrated together.
    fresh : collection of int
        The takes that are to be calibrated: all of a group, or none.
    clocks : mapping of (int, str) to Clock
        The clocks of recordings; sensors of recordings without a clock are excluded.
    wearing : mapping of int to hashable
        The key of the takes that share sensor mounts, by take_id.
    params : CalibrationSettings
        The parameters of the stage.
    """
    given = None
    if groups.source is not None and fresh:
        first = FitTask((takes.take(groups.source),), _own(clocks, [groups.source]), params)
        given = {one.limb: one.fit for one in fit_together(first) if one.fit is not None and not one.left_out}
    for group in groups.groups:
        if group[0] in fresh:
            task = FitTask(tuple(map(takes.take, group)), _own(clocks, group), params)
            if groups.source is not None and group[0] != groups.source:
                task = replace(task, given=given, foreign=wearing[group[0]] != wearing[groups.source])
            yield task


def _own(clocks: Clocks, take_ids: Sequence[int]) -> Clocks:
    return {key: clock for key, clock in clocks.items() if key[0] in take_ids}


def fit_together(task: FitTask) -> list[SensorFit]:
    """Calibrate the sensors of all takes of a task together."""
    worn = [one for take in task.takes for one in _worn(take, task.clocks)]
    if task.given is not None:
        worn = [_with_mount(one, task.given, task.params.source, task.foreign) for one in worn]
    lacking = [  # the sensors that cannot be compared with their take
        SensorFit(take.take_id, take.take, *names, "", left_out=text)
        for take in task.takes
        for names, text in take.lacking.items()
    ]
    return [*_fits(worn, task.params, task.given), *lacking]


def _with_mount(one: _Worn, fits: Mapping[str, StreamFit], source: str, foreign: bool) -> _Worn:
    """Return a sensor unchanged if its mount is given; otherwise return it without its stream, with the reason."""
    if one.left_out:
        return one
    reason = ""
    if foreign:
        reason = f"{source}, which `from` names, is of another wearing"
    elif one.limb.basis != NONE and one.sensor.limb not in fits:
        reason = f"{source}, which `from` names, gives no mount of {one.sensor.limb}"
    return replace(one, stream=None, left_out=reason) if reason else one


def _worn(take: WornTake, clocks: Clocks) -> list[_Worn]:
    """Return the sensors of a take with their orientation streams, or with the reason why they cannot be calibrated."""
    found = []
    for sensor in take.sensors:
        clock = clocks.get((take.take_id, sensor.recording))
        if clock is None:
            found.append(_Worn(take, sensor, None, "the clock of the recording was not found"))
            continue
        stream = stream_of(take, sensor, clock)
        usable = take.limbs[sensor.limb].basis == NONE or stream.valid.any()
        reason = "" if usable else "no frame is known by take and sensor together"
        found.append(_Worn(take, sensor, stream, reason))
    return found


def _options(worn: Sequence[_Worn], params: CalibrationSettings) -> Options:
    """Return the assumptions of a calibration, from the parameters or from the presence of magnetometers."""
    magnetometers = all(one.sensor.magnetometer for one in worn)
    shared = magnetometers if params.world == "auto" else params.world == "shared"
    return Options(
        shared=shared,
        vertical_known=params.vertical == "known",
        # a user who states that sensors share a world states that their headings do not drift
        drift=not (magnetometers or shared) if params.heading == "auto" else params.heading == "drift",
        seed=params.seed,
    )


def _fits(
    worn: Sequence[_Worn],
    params: CalibrationSettings,
    given: Mapping[str, StreamFit] | None = None,
) -> list[SensorFit]:
    """Calibrate sensors together; a limb of which only the axis is known gets the world rotation of the others."""
    options = _options(worn, params)
    usable = [one for one in worn if one.stream is not None and not one.left_out and one.limb.basis != NONE]
    mounts = {limb: fit.q_mount for limb, fit in (given or {}).items()}
    world = next((fit.q_global for fit in given.values()), None) if given and options.shared else None
    streams = _thinned([one.stream for one in usable if one.stream is not None])
    fits = calibrate(streams, options, mounts=mounts, world=world) if streams else []
    of = {id(one): fit for one, fit in zip(usable, fits, strict=True)}
    sound = [fit for fit in fits if not fit.refused]
    shared = sound[0].q_global if sound and options.shared else None
    return [_fit(one, of.get(id(one)), shared) for one in worn]


def _fit(one: _Worn, fit: StreamFit | None, shared: F64 | None) -> SensorFit:
    sensor = one.sensor
    found = SensorFit(
        one.take.take_id, one.take.take, sensor.recording, sensor.sensor, sensor.limb, one.limb.basis,
        left_out=one.left_out,
    )  # fmt: skip
    if one.left_out or one.stream is None:
        return found
    if fit is not None:
        return replace(found, fit=fit, q_global=fit.q_global, left_out=fit.refused)
    if shared is None:
        reason = "only its long axis is known, which needs another limb with an orientation and `global: shared`"
        return replace(found, left_out=f"{sensor.limb}: {reason}")
    sensor_part = np.where(one.limb.valid[:, None], one.stream.sensor, np.nan)
    try:
        direction = mount_direction(sensor_part, one.limb.direction, shared)
    except ParameterError as fault:
        return replace(found, left_out=f"{sensor.limb}: {fault}")
    return replace(found, q_global=shared, direction=direction)


def _thinned(streams: Sequence[Stream]) -> list[Stream]:
    """Return streams with evenly chosen valid frames, if a limb has more than `MAX_FRAMES` of them."""
    frames: dict[str, int] = {}
    for stream in streams:
        frames[stream.limb] = frames.get(stream.limb, 0) + int(stream.valid.sum())
    thinned = []
    for stream in streams:
        every = ceil(frames[stream.limb] / MAX_FRAMES)
        valid = stream.valid
        if every > 1:
            valid = np.zeros(len(stream.valid), np.bool_)
            valid[np.flatnonzero(stream.valid)[::every]] = True
        thinned.append(replace(stream, valid=valid))
    return thinned


def calibration_row(one: SensorFit) -> dict[str, Any]:
    """Return the row of one sensor in one take."""
    fit = one.fit
    row: dict[str, Any] = {
        "take_id": one.take_id,
        "take": one.take,
        "recording": one.recording,
        "sensor": one.sensor,
        "limb": one.limb,
        "basis": one.basis or None,
        "direction": _struct(one.direction, "xyz"),
        "left_out": one.left_out or None,
    }
    found = not one.left_out
    row["q_global"] = _struct(one.q_global if found else None, "wxyz")
    if fit is not None:
        row |= {
            "q_mount": _struct(fit.q_mount if found else None, "wxyz"),
            "frames": fit.frames,
            "inliers": fit.inliers,
            "median_deg": None if isnan(fit.median_deg) else fit.median_deg,
            "observability": fit.observability,
            "tilt_deg": fit.tilt_deg,
            "drift": [
                {"t": t, "degrees": degrees}
                for t, degrees in zip(fit.drift.times.tolist(), fit.drift.degrees.tolist(), strict=True)
            ],
            "warning": fit.warning or None,
        }
    return row


def _struct(values: F64 | None, axes: str) -> dict[str, float] | None:
    return None if values is None else dict(zip(axes, values.tolist(), strict=True))


def stored_calibrations(store: Store, stage: str) -> dict[tuple[int, str, str], dict[str, Any]]:
    """Return the rows of calibrated sensors that a stage has stored, by take_id, recording and sensor."""
    columns = [name for name in result_schema(CALIBRATION).names if name not in ("run", "fingerprint")]
    return {
        (row["take_id"], row["recording"], row["sensor"]): row
        for row in store.result(CALIBRATION, stage=stage).select(columns).to_pylist()
        if row["left_out"] is None
    }
