"""Simulate camera recordings of takes, as files in a new folder, with the truth in a separate folder."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from kinedex.catalog.keypoint_sets import KeypointSet, load_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.simulation.failures import Limbs
from kinedex.ops.simulation.recording import Setup, SimulatedRecording, simulated_recording, take_generators
from kinedex.pipelines.export.export import export_take
from kinedex.pipelines.export.request import How
from kinedex.pipelines.simulation.recording_files import (
    chosen_takes,
    new_folder,
    recording_names,
    require_new,
    write_calibration,
    write_keypoints,
    write_masks,
)
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

RECORDINGS, TRUTH, FAILURES = "recordings.yaml", "truth", "failures.csv"

_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle", "toes")

Progress = Callable[[str, int], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Request:
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
class Simulated:
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


def simulate_cameras(store: Store, request: Request, folder: Path, progress: Progress) -> Simulated:
    """Simulate cameras that record takes of a store.

    The same request writes the same bytes. The folder appears only when it is complete.

    Parameters
    ----------
    store : Store
        The store.
    request : Request
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
    with new_folder(folder) as unfinished:
        made = _write_all(store, request, takes, keypoints, limbs, unfinished, progress)
    return Simulated(folder, *made)


def limbs_of(keypoints: KeypointSet) -> Limbs:
    """Return the keypoints of arms and legs of a keypoint set.

    Raises
    ------
    KinedexError
        The set has no order of keypoints, or lacks a keypoint of an arm or a leg.
    """
    if not keypoints.order:
        raise KinedexError(f"keypoint set '{keypoints.name}' has no order of keypoints; choose one that has")
    at = {place.joint: keypoints.order.index(name) for name, place in keypoints.places.items() if place.joint}

    def pair(parts: Sequence[str]) -> tuple[I64, I64]:
        own = [part for part in parts if part != "toes" or {"ltoes", "rtoes"} <= at.keys()]
        missing = [side + part for part in own for side in "lr" if side + part not in at]
        if missing:
            raise KinedexError(f"keypoint set '{keypoints.name}' has no keypoint at {missing[0]}; choose another set")
        left, right = (np.array([at[side + part] for part in own], np.int64) for side in "lr")
        return left, right

    return Limbs(pair(_ARM), pair(_LEG))


def _write_all(
    store: Store,
    request: Request,
    takes: Sequence[str],
    keypoints: KeypointSet,
    limbs: Limbs,
    folder: Path,
    progress: Progress,
) -> tuple[dict[str, str], int, int]:
    """Write every recording and the recordings file; return the recordings, and numbers of frames and failures."""
    names = recording_names(takes)
    entries: dict[str, dict[str, Any]] = {}
    failures: list[tuple[str, SimulatedRecording]] = []
    frames = 0
    (folder / TRUTH).mkdir()
    with progress("recordings", len(takes)) as bar:
        for name, take in zip(names, takes, strict=True):
            made, positions = _filmed(store, request, take, keypoints, limbs)
            frames += len(made.pixels)
            entries[name] = _write_one(request, keypoints, made, positions, folder, name, store.rate_hz)
            export_take(store, take, How("csv", joints=True), folder / TRUTH / f"{name}.csv")
            entries[name]["truth"] = f"{TRUTH}/{name}.csv"
            failures.append((name, made))
            bar.advance(1)
    (folder / TRUTH / FAILURES).write_bytes(_failures_text(failures).encode())
    text = yaml.safe_dump({"recordings": entries}, sort_keys=False, allow_unicode=True, width=200)
    head = f"# Simulated by kinedex, seed {request.seed}. The truth is for `evaluate_track` alone.\n"
    (folder / RECORDINGS).write_bytes((head + text).encode())
    return dict(zip(names, takes, strict=True)), frames, sum(len(made.failures) for _, made in failures)


def _filmed(
    store: Store, request: Request, take: str, keypoints: KeypointSet, limbs: Limbs
) -> tuple[SimulatedRecording, F64]:
    """Simulate the recording of a take; return it with its joint positions (J, 3, T)."""
    chain = load_kinematic_chain()
    table = store.frames(take).combine_chunks()
    unknown = [joint for joint in chain.joints if joint not in table.column_names]
    if unknown:
        raise KinedexError(f"the store has no joint '{unknown[0]}', which a body before cameras needs")
    positions = np.ascontiguousarray(joint_positions(table, chain.joints), np.float64)
    bad = ~np.isfinite(positions).all(axis=(0, 1))
    if bad.any() or not positions.shape[2]:
        where = f"frame {int(np.argmax(bad))} has a joint without a place" if bad.any() else "it has no frame"
        raise KinedexError(f"take '{take}' cannot be filmed: {where}; leave it out, or film an interval of it")
    body = measured_body(chain, positions)
    points = keypoints.body_points(keypoints.order, body)
    generators = take_generators(request.seed, take)
    made = simulated_recording(request.setup, body, positions, points, limbs, store.rate_hz, generators)
    return made, positions


def _write_one(
    request: Request,
    keypoints: KeypointSet,
    made: SimulatedRecording,
    positions: F64,
    folder: Path,
    name: str,
    rate_hz: float,
) -> dict[str, Any]:
    """Write the files of a recording; return its entry in the recordings file."""
    home = folder / name
    home.mkdir()
    ring = request.setup.ring
    write_calibration(home / "calibration.toml", ring, made)
    entry: dict[str, Any] = {
        "cameras": f"{name}/calibration.toml",
        "keypoints": write_keypoints(home, keypoints, made, request.form),
        "keypoint_set": request.keypoint_set,
        "rate_hz": rate_hz,
        "unit": "m",
        "up": "y",
    }
    if request.silhouettes:
        entry["silhouettes"] = write_masks(home, ring, made, positions)
    return entry


def _failures_text(failures: Sequence[tuple[str, SimulatedRecording]]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["recording", "start", "stop", "kind", "limb", "cameras"])
    for name, made in failures:
        for one in made.failures:
            cameras = " ".join(f"cam{camera + 1}" for camera in one.cameras)
            table.writerow([name, one.start, one.stop, one.kind, one.limb, cameras])
    return text.getvalue()
