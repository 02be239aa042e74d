"""Recordings by simulated cameras, with the true joints and the frames in which tracking fails."""

from __future__ import annotations

import csv
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from kinedex.catalog.cameras import Camera, observed_rays
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.cameras.projection import project
from kinedex.ops.simulation.recording import (
    Detector,
    FailureRate,
    Limbs,
    Setup,
    detected_keypoints,
    keypoint_positions,
    outside_hidden,
    simulated_recording,
    take_generators,
)
from kinedex.ops.tracking.observations import BodyPoints, Rays
from kinedex.ops.tracking.triangulation import triangulate

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

CHAIN = load_kinematic_chain()
KEYPOINTS = load_keypoint_set("coco-17-toes")
MEASURED = tuple(side + part for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for side in "lr")
"""The joints whose error is measured."""

OTHERS = ("02_05", "02_06", "03_04")
"""Takes of no class of the archive."""

LONG_TAKES = (
    "squat1Reps", "jogLeftCircle4StepsRstart", "sneak2StepsLStart", "kickLFront1Reps", "medley", "02_05", "03_04",
)  # fmt: skip
"""The takes of the set with long failures."""

NEVER = FailureRate(per_second=0.0)
"""No failures."""


def _keypoints(*parts: str) -> tuple[I64, I64]:
    left, right = ([KEYPOINTS.order.index(f"{side}_{part}") for part in parts] for side in ("left", "right"))
    return np.array(left), np.array(right)


LIMBS = Limbs(_keypoints("elbow", "wrist"), _keypoints("hip", "knee", "ankle", "big_toe"))


@dataclass(frozen=True, eq=False)
class Filmed:
    """A filmed take with its truth.

    Attributes
    ----------
    name, take : str
        Name of the recording and of the take.
    rate_hz : float
        Frames a second.
    cameras : tuple of Camera
        V cameras.
    pixels, confidence : float64 array (T, V, P, 2), (T, V, P)
        The keypoints of the set `KEYPOINTS`.
    truth : float64 array (T, J, 3)
        The joints of the chain in metres.
    failing : bool array (T,)
        The frames within a failure.
    """

    name: str
    take: str
    rate_hz: float
    cameras: tuple[Camera, ...]
    pixels: F64
    confidence: F64
    truth: F64
    failing: Bool

    @cached_property
    def rays(self) -> Rays:
        """The rays of the keypoints."""
        return observed_rays(self.cameras, self.pixels, self.confidence)

    @cached_property
    def body(self) -> ChainBody:
        """The actor's body: the median bone lengths of the truth."""
        return measured_body(CHAIN, np.ascontiguousarray(self.truth.transpose(1, 2, 0)))

    @cached_property
    def points(self) -> BodyPoints:
        """The keypoints on the actor's body."""
        return KEYPOINTS.body_points(KEYPOINTS.order, self.body)

    def errors_mm(self, positions: F64) -> F64:
        """Return the mean error of the measured joints in each frame (T,), from joints (T, J, 3) of the chain."""
        at = [CHAIN.joint(name) for name in MEASURED]
        errors: F64 = np.linalg.norm(positions[:, at] - self.truth[:, at], axis=2).mean(axis=1) * 1000.0
        return errors

    def keypoint_errors_mm(self, points: F64) -> F64:
        """Return the same from points (T, P, 3) of the keypoints."""
        positions = np.full((len(points), len(CHAIN.joints), 3), np.nan)
        named = self.points.joints >= 0
        positions[:, self.points.joints[named]] = points[:, named]
        return self.errors_mm(positions)


def read_set(folder: Path) -> list[Filmed]:
    """Read the recordings of a folder with cameras.json, keypoints.parquet, truth.parquet and failures.csv."""
    document = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
    truths = read_truth(folder / "truth.parquet")
    rows = pq.read_table(folder / "keypoints.parquet")
    recordings = np.array(rows["recording"].to_pylist())
    columns = {name: rows[name].to_numpy() for name in ("camera", "frame", "keypoint", "x", "y", "confidence")}
    with (folder / "failures.csv").open(encoding="utf-8", newline="") as file:
        failures = list(csv.DictReader(file))
    found = []
    for name, cameras in document["recordings"].items():
        take = name.rpartition("_seed")[0]
        mine = recordings == name
        at = tuple(columns[key][mine] for key in ("frame", "camera", "keypoint"))
        pixels = np.zeros((len(truths[take]), len(cameras), len(KEYPOINTS.order), 2))
        confidence = np.zeros(pixels.shape[:3])
        pixels[at] = np.stack([columns["x"][mine], columns["y"][mine]], axis=-1)
        confidence[at] = columns["confidence"][mine]
        spans = [(int(row["start"]), int(row["stop"])) for row in failures if row["recording"] == name]
        seen = tuple(_camera(number, one) for number, one in enumerate(cameras))
        failing = _within(spans, len(pixels))
        found.append(Filmed(name, take, document["rate_hz"], seen, pixels, confidence, truths[take], failing))
    return found


def _camera(number: int, one: dict[str, list[float]]) -> Camera:
    rotation = np.array(one["rotation"])
    move = -rotation @ np.array(one["centre"])
    width, height = (int(side) for side in one["size"])
    return Camera(f"cam{number + 1}", np.array(one["matrix"]), np.zeros(0), rotation, move, (width, height))


def read_truth(path: Path) -> dict[str, F64]:
    """Read the joints (T, J, 3) of every take of a file."""
    table = pq.read_table(path)
    takes = np.array(table["take"].to_pylist())
    joints = [
        np.stack([table[name].combine_chunks().field(axis).to_numpy() for axis in "xyz"], axis=1)
        for name in CHAIN.joints
    ]
    positions = np.stack(joints, axis=1).astype(np.float64)
    return {name: positions[takes == name] for name in dict.fromkeys(takes.tolist())}


def _within(spans: Sequence[tuple[int, int]], frames: int) -> Bool:
    failing = np.zeros(frames, bool)
    for start, stop in spans:
        failing[start:stop] = True
    return failing


def filmed(take: str, truth: F64, rate_hz: float, seed: int, setup: Setup | None = None) -> Filmed:
    """Film a take by simulated cameras.

    Parameters
    ----------
    take : str
        Name of the take.
    truth : float64 array (T, J, 3)
        Its joints in metres.
    rate_hz : float
        Frames a second.
    seed : int
        Seed of cameras, keypoints and failures.
    setup : Setup, optional
        What it is made with.
    """
    chosen = setup or Setup()
    positions = np.ascontiguousarray(truth.transpose(1, 2, 0))
    body = measured_body(CHAIN, positions)
    points = KEYPOINTS.body_points(KEYPOINTS.order, body)
    made = simulated_recording(chosen, body, positions, points, LIMBS, rate_hz, take_generators(seed, take))
    cameras = tuple(
        Camera(f"cam{number + 1}", chosen.ring.matrix, np.zeros(0), turn, move, chosen.ring.size)
        for number, (turn, move) in enumerate(zip(made.rotations, made.translations, strict=True))
    )
    failing = _within([(one.start, one.stop) for one in made.failures], len(truth))
    return Filmed(f"{take}_seed{seed}", take, rate_hz, cameras, made.pixels, made.confidence, truth, failing)


def without_failures(one: Filmed) -> Filmed:
    """Return a recording that was read as the detector would report it if it never failed.

    Its cameras and the keypoints outside failures stay. Within failures they are drawn anew, with the places in their
    segments that they have elsewhere in the recording.
    """
    generator, detector = np.random.default_rng(zlib.crc32(one.name.encode())), Detector()
    positions = np.ascontiguousarray(one.truth.transpose(1, 2, 0))
    segments = np.zeros((3, len(one.points.nodes), 3))
    unmoved = keypoint_positions(one.body, positions, one.points, segments[0])
    for axis in range(3):
        segments[axis, :, axis] = 1.0
    axes = np.stack([keypoint_positions(one.body, positions, one.points, unit) - unmoved for unit in segments], axis=2)
    gaps = triangulate(one.rays)[0] - unmoved
    seen = np.where(one.failing[:, None, None], np.nan, np.einsum("tpai,tpi->tpa", axes, gaps))
    places = unmoved + np.einsum("tpai,pa->tpi", axes, np.nanmedian(seen, axis=0))
    true = [project(camera.matrix, camera.rotation, camera.translation, (), places)[0] for camera in one.cameras]
    drawn = outside_hidden(*detected_keypoints(detector, np.stack(true, axis=1), generator), one.cameras[0].size)
    failing = one.failing[:, None, None]
    pixels = np.where(failing[..., None], drawn[0], one.pixels)
    return replace(one, pixels=pixels, confidence=np.where(failing, drawn[1], one.confidence))
