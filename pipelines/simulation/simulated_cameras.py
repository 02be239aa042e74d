"""Simulate camera recordings of takes, as files in a new folder, with the truth in a separate folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.keypoint_sets import KeypointSet, load_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.kinematic_chain import ChainBody, vector_of
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.simulation.recording import (
    CameraRing,
    Limbs,
    Setup,
    SimulatedRecording,
    simulated_recording,
    take_generators,
)
from kinedex.ops.tracking.views import camera_view, render_mask
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
from kinedex.storage.store.store import Store

FAILURES = "failures.csv"

_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle", "toes")

MASK_PART = 2
"""The factor by which masks are smaller than the images, if it divides width and height."""


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


def camera_names(count: int) -> list[str]:
    """Return the names of the cameras: cam1, cam2, …"""
    return [f"cam{number + 1}" for number in range(count)]


def write_calibration(path: Path, ring: CameraRing, made: SimulatedRecording) -> None:
    """Write the cameras in the TOML format of AniPose and Pose2Sim: rotation vectors, lengths in metres."""
    lines = []
    for name, rotation, translation in zip(camera_names(ring.count), made.rotations, made.translations, strict=True):
        vector = vector_of(np.ascontiguousarray(rotation))
        lines += [
            f"[{name}]",
            f'name = "{name}"',
            f"size = [{ring.size[0]}, {ring.size[1]}]",
            f"matrix = {ring.matrix.tolist()}",
            "distortions = [0.0, 0.0, 0.0, 0.0]",
            f"rotation = {vector.tolist()}",
            f"translation = {translation.tolist()}",
            "",
        ]
    path.write_bytes("\n".join(lines).encode())


def write_keypoints(home: Path, keypoints: KeypointSet, made: SimulatedRecording, form: str) -> str:
    """Write the keypoints of a recording.

    Parameters
    ----------
    home : Path
        The folder of the recording.
    keypoints : KeypointSet
        The names of the P keypoints.
    made : SimulatedRecording
        The recording.
    form : str
        The format: parquet, one table; or openpose, a JSON file for each frame in a folder for each camera.

    Returns
    -------
    str
        The path of the files, as written in the recordings file.
    """
    names = camera_names(made.pixels.shape[1])
    if form == "openpose":
        for v, name in enumerate(names):
            (home / "keypoints" / name).mkdir(parents=True)
            for t in range(len(made.pixels)):
                path = home / "keypoints" / name / f"{name}_{t:06d}_keypoints.json"
                path.write_bytes(_openpose(made.pixels[t, v], made.confidence[t, v]).encode())
        return f"{home.name}/keypoints/{{camera}}/*.json"
    frames, cameras, points = made.confidence.shape
    t, v, p = (axis.ravel() for axis in np.indices((frames, cameras, points)))
    table = pa.table(
        {
            "camera": pa.DictionaryArray.from_arrays(pa.array(v, pa.int32()), pa.array(names)),
            "frame": pa.array(t, pa.int32()),
            "keypoint": pa.DictionaryArray.from_arrays(pa.array(p, pa.int32()), pa.array(list(keypoints.order))),
            "x": pa.array(made.pixels[..., 0].ravel(), pa.float32()),
            "y": pa.array(made.pixels[..., 1].ravel(), pa.float32()),
            "confidence": pa.array(made.confidence.ravel(), pa.float32()),
        }
    )
    pq.write_table(table, home / "keypoints.parquet", compression="zstd")
    return f"{home.name}/keypoints.parquet"


def _openpose(pixels: F64, confidence: F64) -> str:
    """Return the JSON of a frame of a camera; it has no person if no keypoint is seen."""
    rows = np.round(np.concatenate([pixels, confidence[:, None]], axis=1), 4)
    person = {"person_id": [-1], "pose_keypoints_2d": rows.ravel().tolist()}
    return json.dumps({"version": 1.3, "people": [person] if confidence.any() else []}) + "\n"


def write_masks(home: Path, ring: CameraRing, made: SimulatedRecording, body: ChainBody, positions: F64) -> str:
    """Write a mask for each frame and camera, except for frames in which a camera is blank.

    Parameters
    ----------
    home : Path
        The folder of the recording.
    ring : CameraRing
        The cameras.
    made : SimulatedRecording
        The recording.
    body : ChainBody
        The body that is drawn.
    positions : float64 array (J, 3, T)
        The joints of the chain in metres.

    Returns
    -------
    str
        The path of the files, as written in the recordings file.
    """
    from PIL import Image

    capsules = body_capsules(body, load_surface())
    part = MASK_PART if not any(side % MASK_PART for side in ring.size) else 1
    width, height = (side // part for side in ring.size)
    blank = np.zeros(made.confidence.shape[:2], bool)
    for one in made.failures:
        if one.kind == "views":
            blank[one.start : one.stop, list(one.cameras)] = True
    for v, name in enumerate(camera_names(ring.count)):
        (home / "masks" / name).mkdir(parents=True)
        view = camera_view(ring.matrix, made.rotations[v], made.translations[v], (), ring.size, (width, height))
        for t in np.flatnonzero(~blank[:, v]).tolist():
            mask = render_mask(capsules, np.ascontiguousarray(positions[:, :, t]), view)
            image = Image.fromarray(np.where(mask, 255, 0).astype(np.uint8), mode="L")
            image.save(home / "masks" / name / f"{name}_{t:06d}.png", optimize=False, compress_level=6)
    return f"{home.name}/masks/{{camera}}/*.png"
