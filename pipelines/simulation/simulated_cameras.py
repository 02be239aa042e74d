"""Simulate camera recordings of takes, as files in a new folder, with the truth in a separate folder."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.keypoint_sets import KeypointSet, load_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.simulation.recording import (
    Limbs,
    Setup,
    SimulatedRecording,
    simulated_recording,
    take_generators,
)
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.export.data_set import export_take
from kinedex.pipelines.export.request import ClipOptions
from kinedex.pipelines.simulation.recording_folder import RECORDINGS as RECORDINGS
from kinedex.pipelines.simulation.recording_folder import (
    TRUTH,
    chosen_takes,
    filmed_joints,
    require_new,
    write_recordings,
)
from kinedex.storage.formats.cameras.simulated_files import write_calibration, write_keypoints, write_masks
from kinedex.storage.store.store import Store

FAILURES = "failures.csv"

_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle", "toes")


@dataclass(frozen=True)
class CameraRequest:
    """A request to simulate cameras: the takes, and how they are recorded.

    Attributes
    ----------
    takes : tuple of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects takes besides the named ones.
    seed : int
        Seed of all random numbers, 0 or above.
    setup : Setup
        Cameras, errors and failures.
    keypoint_set : str
        The keypoint set, a shipped one or the path of a file.
    form : str
        Format of the keypoints: parquet or openpose.
    silhouettes : bool
        True to write masks as well.
    """

    takes: tuple[str, ...] = ()
    where: str | None = None
    seed: int = 0
    setup: Setup = field(default_factory=Setup)
    keypoint_set: str = "coco-17-toes"
    form: str = "parquet"
    silhouettes: bool = False

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError("seed", "at least 0", self.seed)
        if self.form not in ("parquet", "openpose"):
            raise ParameterError("form", "parquet or openpose", self.form)
        if self.setup.ring.count < 2:
            raise ParameterError("cameras", "at least 2: tracking triangulates joints", self.setup.ring.count)


@dataclass(frozen=True)
class SimulatedCameras:
    """The recordings that were made.

    Attributes
    ----------
    folder : Path
        Their folder.
    recordings : dict of str to str
        Name of each recording → the take that it shows.
    frames, failures : int
        The numbers of frames and of failures in all recordings.
    """

    folder: Path
    recordings: dict[str, str]
    frames: int
    failures: int


def simulate_cameras(store: Store, request: CameraRequest, folder: Path, progress: Progress) -> SimulatedCameras:
    """Simulate cameras that record takes of a store.

    The same request writes the same bytes. The folder appears only when it is complete.

    Parameters
    ----------
    store : Store
        The store.
    request : CameraRequest
        The takes, and how they are recorded.
    folder : Path
        A folder that does not exist, or is empty.
    progress : callable
        Shows progress.

    Raises
    ------
    KinedexError
        The folder contains files, there is no such take, or a take cannot be recorded.
    """
    require_new(folder)
    takes = chosen_takes(store, request.takes, request.where)
    keypoints = load_keypoint_set(request.keypoint_set)
    limbs = limbs_of(keypoints)
    frames = failures = 0

    def record(unfinished: Path, name: str, take: str) -> dict[str, Any]:
        nonlocal frames, failures
        made, body, positions = _filmed(store, request, take, keypoints, limbs)
        frames, failures = frames + len(made.pixels), failures + len(made.failures)
        home = unfinished / name
        home.mkdir()
        write_calibration(home / "calibration.toml", request.setup.ring, made)
        entry: dict[str, Any] = {
            "cameras": f"{name}/calibration.toml",
            "keypoints": write_keypoints(home, keypoints, made, request.form),
            "keypoint_set": request.keypoint_set,
            "rate_hz": store.rate_hz,
            "unit": "m",
            "up": "y",
        }
        if request.silhouettes:
            entry["silhouettes"] = write_masks(home, request.setup.ring, made, body, positions)
        export_take(store, take, ClipOptions("csv", joints=True), unfinished / TRUTH / f"{name}.csv")
        _add_failures(unfinished / TRUTH / FAILURES, name, made)
        return entry | {"truth": f"{TRUTH}/{name}.csv"}

    head = f"# Simulated by kinedex, seed {request.seed}. The truth is for `evaluate_track` alone.\n"
    shown = write_recordings(folder, takes, head, progress, record)
    return SimulatedCameras(folder, shown, frames, failures)


def limbs_of(keypoints: KeypointSet) -> Limbs:
    """Return the keypoints of arms and legs of a keypoint set.

    Raises
    ------
    KinedexError
        The set has no order of keypoints, or lacks a keypoint of an arm or a leg.
    """
    if not keypoints.order:
        raise KinedexError(f"keypoint set '{keypoints.name}' has no order of keypoints; choose one that has")
    at = {place.joint: keypoints.order.index(name) for name, place in keypoints.positions.items() if place.joint}

    def pair(parts: Sequence[str]) -> tuple[I64, I64]:
        own = [part for part in parts if part != "toes" or {"ltoes", "rtoes"} <= at.keys()]
        missing = [side + part for part in own for side in "lr" if side + part not in at]
        if missing:
            raise KinedexError(f"keypoint set '{keypoints.name}' has no keypoint at {missing[0]}; choose another set")
        left, right = (np.array([at[side + part] for part in own], np.int64) for side in "lr")
        return left, right

    return Limbs(pair(_ARM), pair(_LEG))


def _filmed(
    store: Store, request: CameraRequest, take: str, keypoints: KeypointSet, limbs: Limbs
) -> tuple[SimulatedRecording, ChainBody, F64]:
    """Simulate the recording of a take; return it with the body and its joint positions (J, 3, T)."""
    chain = load_kinematic_chain()
    positions = filmed_joints(store, take, chain.joints)
    bad = ~np.isfinite(positions).all(axis=(0, 1))
    if bad.any() or not positions.shape[2]:
        where = f"frame {int(np.argmax(bad))} has a joint without a place" if bad.any() else "it has no frame"
        raise KinedexError(f"take '{take}' cannot be filmed: {where}; leave it out, or film an interval of it")
    body = measured_body(chain, positions)
    points = keypoints.body_points(keypoints.order, body)
    generators = take_generators(request.seed, take)
    made = simulated_recording(request.setup, body, positions, points, limbs, store.rate_hz, generators)
    return made, body, positions


def _add_failures(path: Path, name: str, made: SimulatedRecording) -> None:
    """Add the failures of a recording to the table of all recordings."""
    with path.open("a", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        if not file.tell():
            table.writerow(["recording", "start", "stop", "kind", "limb", "cameras"])
        for one in made.failures:
            cameras = " ".join(f"cam{camera + 1}" for camera in one.cameras)
            table.writerow([name, one.start, one.stop, one.kind, one.limb, cameras])
