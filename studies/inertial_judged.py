"""Takes of the study of simulated sensors after synchronisation and calibration, with their errors counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.ops.evaluation.threshold_counts import threshold_counts
from kinedex.pipelines.inertial.limb_error_curves import LimbCurve, take_errors
from kinedex.pipelines.inertial.parameters import CalibrateParameters, LimbErrorsParameters, SynchroniseParameters
from kinedex.pipelines.inertial.sensor_fits import FitTask, SensorFit, calibration_row, fit_together
from kinedex.pipelines.inertial.synchronisation import synchronise
from kinedex.pipelines.inertial.worn_sensors import Clock, WornTake
from studies.inertial_trials import RECORDING, Trial

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judged:
    """A trial after synchronisation and calibration: its clock, its fits, and the errors of its limbs."""

    trial: Trial
    clock: Clock
    fits: list[SensorFit]
    curves: tuple[LimbCurve, ...]

    def counts(self, limbs: str, taus: Sequence[float]) -> list[Counts]:
        """Return the counts of limbs whose names end so at thresholds."""
        own = [
            limb_counts(one.error, one.valid, labels_of(self.trial, one.limb), taus)
            for one in self.curves
            if one.limb.endswith(limbs) and one.limb != "torso"
        ]
        return [pooled(some) for some in zip(*own, strict=True)]


def judge_together(trials: Sequence[Trial]) -> list[Judged]:
    """Calibrate trials of one actor together, each with the clock that was found from itself."""
    clocks: dict[tuple[int, str], Clock] = {}
    takes = list[WornTake]()
    for number, trial in enumerate(trials, 1):
        clocks[number, RECORDING] = clock_of(trial)
        takes.append(replace(trial.take, take_id=number))
    fits = fit_together(FitTask(tuple(takes), clocks, CalibrateParameters.model_validate({"from": "actor"})))
    return [
        Judged(trial, clocks[number, RECORDING], own, curves_of(trial.take, clocks[number, RECORDING], own))
        for number, trial in enumerate(trials, 1)
        for own in [[one for one in fits if one.take_id == number]]
    ]


def judge(trial: Trial) -> Judged:
    """Find clock and mounts of a trial from itself, errors and all, and compare its limbs with the sensors."""
    clock = clock_of(trial)
    fits = fit_together(FitTask((trial.take,), {(1, RECORDING): clock}, CalibrateParameters.model_validate({})))
    return Judged(trial, clock, fits, curves_of(trial.take, clock, fits))


def clock_of(trial: Trial) -> Clock:
    """Find the clock of a trial from itself."""
    found = synchronise(trial.take, RECORDING, SynchroniseParameters.model_validate({}))
    assert found.clock is not None, found.left_out
    return found.clock


def curves_of(take: WornTake, clock: Clock, fits: Sequence[SensorFit]) -> tuple[LimbCurve, ...]:
    """Return the errors of the limbs of a take, given its clock and the mounts of its sensors."""
    rows: dict[tuple[int, str, str], Any] = {
        (1, RECORDING, one.sensor): {"drift": (), **calibration_row(one)} for one in fits if not one.left_out
    }
    return take_errors(take, {(1, RECORDING): clock}, rows, LimbErrorsParameters.model_validate({})).curves


def labels_of(trial: Trial, limb: str) -> list[tuple[int, int]]:
    """Return the frames of a limb that are wrong."""
    return [(one.start, one.stop) for one in trial.labels if one.limb == limb]


def limb_counts(
    error: F64, valid: npt.NDArray[np.bool_], labels: Sequence[tuple[int, int]], taus: Sequence[float]
) -> list[Counts]:
    """Return the counts of a limb; frames that do not count are taken out of both sides."""
    place = np.concatenate([[0], np.cumsum(valid)])
    bounds = place[np.asarray(labels, np.int64).reshape(-1, 2)]
    return threshold_counts(error[valid], bounds[bounds[:, 0] < bounds[:, 1]], taus)
