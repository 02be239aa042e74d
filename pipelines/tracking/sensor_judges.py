"""Evaluate tracked and stabilised takes by sensors, from the errors of their limbs in `limb_errors`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.pipelines.inertial.limb_error_tables import judged_limbs
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

SENSORS, LIMB = "sensors", "limb"
"""The reference of evaluations by sensors (also the scope of all limbs together), and the scope of a single limb."""


def judged_by_sensors(store: Store, stage: str, take_ids: Collection[int]) -> list[dict[str, Any]]:
    """Return error statistics of takes against sensors: for all limbs of a take together, then for each limb.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored `limb_errors`, "<pipeline>/<stage>".
    take_ids : collection of int
        The ids of the takes to evaluate.
    """
    rows: list[dict[str, Any]] = []
    for limbs in judged_limbs(store, stage):
        own = [(one.limb, one.error[one.valid]) for one in limbs if one.take_id in take_ids and one.valid.any()]
        if not own:
            continue
        named = {"take_id": limbs[0].take_id, "take": limbs[0].take, "reference": SENSORS}
        rows.append(named | _figures(SENSORS, "all", np.concatenate([error for _, error in own])))
        rows += [named | _figures(LIMB, limb, error) for limb, error in own]
    return rows


def _figures(scope: str, name: str, error: F64) -> dict[str, Any]:
    return {
        "scope": scope,
        "name": name,
        "frames": len(error),
        "mean_deg": float(error.mean()),
        "sd_deg": float(error.std()),
        "median_deg": float(np.median(error)),
        "max_deg": float(error.max()),
    }
