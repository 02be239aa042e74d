"""Read the takes in which sensors were worn, with their limbs, and find the takes whose results are reused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.arrays import F64
from kinedex.ops.errors import StoreError
from kinedex.ops.inertial.hand_eye import Stream
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.inertial.limb_motion import limbs_of_rows, struct_rows
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.reused_results import rows_in_order, stored_fingerprints
from kinedex.storage.store.store import Store

Pieces = Callable[[pa.Table], Iterable[pa.Table]]

Value = TypeVar("Value")
SYNC = "sensor_sync"
"""The kind of results with the clocks of recordings."""


class ReusedTakes:
    """The takes of a stage, divided into those whose rows are reused and those that are computed again.

    A take is computed unless its earlier rows have its current fingerprint. All takes are computed if the stage runs
    with `--force`, if its code is unknown, or if a part of its earlier results is damaged.

    Parameters
    ----------
    context : StageContext
        The stage.
    store : Store
        The store with its earlier results.
    prints : mapping of int to (str or None)
        The ids of all takes in the order of results, each with a hash of everything that determines its rows; None if
        it is unknown.
    *kinds : str
        The kinds of results of the stage, all with a column `take_id`, the first one with `fingerprint`.
    """

    def __init__(self, context: StageContext, store: Store, prints: Mapping[int, str | None], *kinds: str) -> None:
        self._context, self._store = context, store
        self._takes = tuple(prints)
        reusable = bool(context.code) and not context.anew and _are_sound(store, context.key(), kinds)
        before = stored_fingerprints(store, kinds[0], context.key()) if reusable else {}
        self.fresh = tuple(one for one, print_ in prints.items() if print_ is None or before.get(one) != print_)
        """The ids of the takes that are computed, in order."""

    @property
    def unchanged(self) -> int:
        """The number of takes whose rows are reused."""
        return len(self._takes) - len(self.fresh)

    def rows(
        self, kind: str, tables: Iterable[pa.Table], pieces: Pieces = lambda rows: (rows,)
    ) -> Iterator[pa.Table | ResultPart]:
        """Yield the rows of all takes in their order, in the form that `StoreWriter.put_results` takes.

        Parameters
        ----------
        kind : str
            The kind of results.
        tables : iterable of pyarrow.Table
            The rows of each take of `fresh`, in their order.
        pieces : callable, optional
            Divides the rows of one take into pieces, between which a row group may end.
        """
        context = self._context
        return rows_in_order(
            self._store, kind, context.key(), self._takes, self.fresh, tables, run=context.run, pieces=pieces
        )

    def put(self, kind: str, tables: Iterable[pa.Table], pieces: Pieces = lambda rows: (rows,)) -> None:
        """Store the rows of all takes, and commit them; the parameters are those of `rows`."""
        with self._context.writer() as writer:
            rows = self.rows(kind, tables, pieces)
            writer.put_results(kind, rows, stage=self._context.key(), run=self._context.run)
            writer.commit()

    def report(self, what: str) -> None:
        """Show how many takes were reused, if any; `what` names the work that was saved, such as "not read"."""
        if self.unchanged:
            self._context.message(f"unchanged: {counted(self.unchanged, 'take')}, {what} again")


def _are_sound(store: Store, stage: str, kinds: Iterable[str]) -> bool:
    """Return whether all parts of a stage's results can be read."""
    try:
        store.checked.parts([part for kind in kinds for part in store.stage_parts(kind, stage)])
    except StoreError:
        return False  # repair removes damaged parts, and the stage then computes all rows again
    return True


def take_tables(kind: str, rows: Iterable[dict[str, Any]], takes: Iterable[int], run: str) -> list[pa.Table]:
    """Return rows of a kind of results as one table for each take, in the order of takes.

    Parameters
    ----------
    kind : str
        The kind of results.
    rows : iterable of dict
        Rows with `take_id`; the order of rows within a take is kept.
    takes : iterable of int
        The ids of the takes.
    run : str
        Id of the run.
    """
    own: dict[int, list[dict[str, Any]]] = {take_id: [] for take_id in takes}
    for row in rows:
        own[row["take_id"]].append(row)
    return [result_table(kind, some, run) for some in own.values()]


@dataclass(frozen=True, eq=False)
class WornSensor:
    """The samples of a sensor that was worn on a limb.

    Attributes
    ----------
    recording, sensor, limb : str
        Names.
    times : float64 array (N,)
        Times by the recording's clock in seconds, ascending.
    gyr : float64 array (N, 3) or None
        Angular velocity in rad/s, NaN where not measured; None for a sensor without gyroscope.
    orientation : float64 array (N, 4)
        Unit quaternions (w, x, y, z) from the sensor to its world F_GI; NaN if unknown.
    magnetometer : bool
        True if the sensor has a magnetometer, so that its heading is not arbitrary.
    """

    recording: str
    sensor: str
    limb: str
    times: F64
    gyr: F64 | None
    orientation: F64
    magnetometer: bool


@dataclass(frozen=True)
class Clock:
    """The clock of a recording: sensor time = take time + offset_s + ppm · 10⁻⁶ · take time."""

    offset_s: float
    ppm: float = 0.0

    def sensor_time(self, times: F64) -> F64:
        """Convert times of the take, in seconds, to times of the recording."""
        return times * (1.0 + 1e-6 * self.ppm) + self.offset_s


@dataclass(frozen=True, eq=False)
class WornTake:
    """A take with the sensors that were worn in it.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take : str
        Its name.
    limbs : dict of str to LimbMotion
        Its limbs by name.
    sensors : tuple of WornSensor
        The sensors on limbs that the take has, by recording and name.
    lacking : dict of (str, str, str) to str
        Recording, sensor and limb → the reason why they cannot be compared.
    """

    take_id: int
    take: str
    limbs: Mapping[str, LimbMotion]
    sensors: tuple[WornSensor, ...]
    lacking: Mapping[tuple[str, str, str], str]

    @property
    def recordings(self) -> tuple[str, ...]:
        """The recordings with sensors that can be compared."""
        return tuple(dict.fromkeys(sensor.recording for sensor in self.sensors))


class WornTakes:
    """The takes of a store in which sensors were worn on limbs, sorted by name.

    Parameters
    ----------
    store : Store
        The store.
    limbs : str
        The stage that has stored `limb_orientations`, "<pipeline>/<stage>".
    sensors : str
        The stage that has stored `imu_samples`.
    """

    def __init__(self, store: Store, limbs: str, sensors: str) -> None:
        self._store, self._stage = store, limbs
        self._limbs = RowGroups(store, "limb_orientations", limbs, "take_id")
        self._samples = RowGroups(store, "imu_samples", sensors, "recording")
        worn: dict[int, list[dict[str, object]]] = {}
        for row in store.result("imu_recordings", stage=sensors).to_pylist():
            if row["take_id"] is not None and row["limb"] is not None:
                worn.setdefault(row["take_id"], []).append(row)
        by_name = sorted((str(rows[0]["take"]), key) for key, rows in worn.items())
        self._rows = {key: worn[key] for _, key in by_name if key in self._limbs}
        self.without_limbs = [name for name, key in by_name if key not in self._limbs]
        """The names of takes with sensors whose limbs were not read."""

    @classmethod
    def of(cls, context: StageContext, store: Store) -> WornTakes:
        """Return the takes of the limbs and sensors that are inputs of a stage; limbs with errors take precedence."""
        limbs = context.inputs.get("broken", context.inputs["limbs"])
        return cls(store, context.key(limbs), context.key(context.inputs["sensors"]))

    @property
    def names(self) -> dict[int, str]:
        """The names of the takes, by take_id."""
        return {take_id: str(rows[0]["take"]) for take_id, rows in self._rows.items()}

    def fingerprints(self, *more: object, of: Callable[[int], object] = lambda _: None) -> dict[int, str | None]:
        """Return a hash of everything that determines the results of each take, by take_id; None if it is unknown.

        Parameters
        ----------
        *more : object
            Further values that the results of all takes depend on, besides limbs and sensors.
        of : callable, optional
            Returns further values that the results of one take depend on, given its take_id.
        """
        limbs = stored_fingerprints(self._store, "limb_orientations", self._stage)
        found: dict[int, str | None] = {}
        for take_id, rows in self._rows.items():
            sensors = sorted((str(row["recording"]), str(row["sensor"]), row["fingerprint"] or "") for row in rows)
            known = take_id in limbs and all(one for _, _, one in sensors)
            found[take_id] = hash_of(*more, limbs[take_id], sensors, of(take_id)) if known else None
        return found

    def __len__(self) -> int:
        return len(self._rows)

    def take(self, take_id: int) -> WornTake:
        """Return a take with its limbs and sensors."""
        rows = self._rows[take_id]
        worn = self._limbs.rows(take_id, "limb", {str(row["limb"]) for row in rows})
        limbs = limbs_of_rows(worn).limbs if worn.num_rows else {}
        take = str(rows[0]["take"])
        sensors: list[WornSensor] = []
        lacking: dict[tuple[str, str, str], str] = {}
        samples: dict[str, pa.Table] = {}
        for row in sorted(rows, key=lambda row: (str(row["recording"]), str(row["sensor"]))):
            recording, sensor, limb = str(row["recording"]), str(row["sensor"]), str(row["limb"])
            if limb not in limbs:
                lacking[recording, sensor, limb] = f"{take} has no {limb}"
                continue
            if recording not in samples:
                samples = {recording: self._samples.rows(recording)}
            worn = _worn(samples[recording], row)
            if not np.isfinite(worn.orientation).any():
                lacking[recording, sensor, limb] = f"sensor {sensor} of {recording} has no orientations"
                continue
            sensors.append(worn)
        return WornTake(take_id, take, limbs, tuple(sensors), lacking)


def _worn(samples: pa.Table, row: Mapping[str, object]) -> WornSensor:
    own = samples.filter(pc.equal(samples.column("sensor"), str(row["sensor"])))
    gyr = own.column("gyr")
    channels = row["channels"]
    return WornSensor(
        str(row["recording"]),
        str(row["sensor"]),
        str(row["limb"]),
        own.column("t").to_numpy(),
        None if gyr.null_count == len(gyr) else struct_rows(gyr, "xyz"),
        struct_rows(own.column("orientation"), "wxyz"),
        isinstance(channels, list) and "mag" in channels,
    )


def stream_of(take: WornTake, sensor: WornSensor, clock: Clock) -> Stream:
    """Return a sensor's orientations at the frames of a take, together with those of its limb.

    Frames in which the limb is unknown or jumps, or that lie in gaps of the sensor, are not valid.
    """
    limb = take.limbs[sensor.limb]
    orientation, known = interpolate(sensor.times, sensor.orientation, clock.sensor_time(limb.times))
    valid = known & limb.valid & ~limb.jump & np.isfinite(limb.orientation).all(axis=1)
    return Stream(sensor.limb, take.take, limb.times, orientation, limb.orientation, valid)


def stored_clocks(store: Store, stage: str) -> dict[tuple[int, str], Clock]:
    """Return the clocks that a stage has found, by take_id and recording."""
    return {
        (row["take_id"], row["recording"]): Clock(row["offset_s"], row["ppm"])
        for row in store.result(SYNC, stage=stage).to_pylist()
        if row["offset_s"] is not None
    }


def by_take(found: Mapping[tuple[Any, ...], Value]) -> dict[int, list[tuple[tuple[Any, ...], Value]]]:
    """Return clocks or calibrations with their keys, grouped by take_id and sorted."""
    own: dict[int, list[tuple[tuple[Any, ...], Value]]] = {}
    for key in sorted(found):
        own.setdefault(key[0], []).append((key, found[key]))
    return own
