"""Simulate depth-camera recordings of takes, as files in a new folder, with the truth in a separate folder."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.catalog.filmed_bodies import FilmedBody, load_filmed_body
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.simulation.depth_scene import CameraPlace, DepthScene, on_floor, place_camera
from kinedex.ops.simulation.depth_sensors import SENSORS, UNIT_M, DepthSensor
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.simulation.recording_folder import RECORDINGS as RECORDINGS
from kinedex.pipelines.simulation.recording_folder import (
    TRUTH,
    chosen_takes,
    filmed_joints,
    require_new,
    write_recordings,
)
from kinedex.storage.formats.depth.camera_file import write_camera
from kinedex.storage.formats.depth.png import write_depth_png
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.table_writer import write_csv
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class DepthRequest:
    """A request to simulate a depth camera: the takes, and how they are recorded.

    Attributes
    ----------
    takes : tuple of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects takes besides the named ones.
    seed : int
        Seed of all random numbers, 0 or above.
    camera : str
        The camera, one of `SENSORS`.
    body : str
        The body, a shipped one of `configs/bodies/filmed` or the path of a file.
    azimuth_deg : float
        The angle of the camera, in degrees to the left of the direction that the person mostly faces.
    interval : tuple of (int, int) or None
        The frames [start, stop) of every take to record; None for all frames.
    """

    takes: tuple[str, ...] = ()
    where: str | None = None
    seed: int = 0
    camera: str = "tof"
    body: str = "first"
    azimuth_deg: float = 0.0
    interval: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError("seed", "at least 0", self.seed)
        if self.camera not in SENSORS:
            names = ", ".join(SENSORS)
            raise KinedexError(f"no camera is called '{self.camera}'{did_you_mean(self.camera, SENSORS)}; use {names}")
        if not -360 <= self.azimuth_deg <= 360:
            raise ParameterError("azimuth", "from -360 to 360 degrees", self.azimuth_deg)


@dataclass(frozen=True)
class SimulatedDepth:
    """The recordings that were made.

    Attributes
    ----------
    folder : Path
        Their folder.
    recordings : dict of str to str
        Name of each recording → the take that it shows.
    frames : int
        The number of frames of all recordings.
    outside : dict of str to int
        Name of each recording with frames in which part of the body is out of view → the number of such frames.
    """

    folder: Path
    recordings: dict[str, str]
    frames: int
    outside: dict[str, int]


@dataclass(frozen=True, eq=False)
class FilmedTake:
    """A take that is recorded by a simulated depth camera.

    Attributes
    ----------
    scene : DepthScene
        The room, the body and the camera; the first image that is drawn must be the background.
    place : CameraPlace
        The position and orientation of the camera.
    joints : float64 array (T, 24, 3)
        The true joints in metres, Y up, with the floor at Y = 0.
    """

    scene: DepthScene
    place: CameraPlace
    joints: F64


def film_take(
    sensor: DepthSensor, body: FilmedBody, joints: F64, bone_lengths: F64, azimuth_deg: float, seed: list[int]
) -> FilmedTake:
    """Place a take in front of a simulated depth camera.

    Parameters
    ----------
    sensor : DepthSensor
        The camera.
    body : FilmedBody
        The body.
    joints : float64 array (T, 24, 3)
        The named joints in metres, Y up.
    bone_lengths : float64 array (24,)
        Bone lengths of the person in metres, which determine the standing height.
    azimuth_deg : float
        The angle of the camera to the person's left, in degrees.
    seed : list of int
        Seeds of the random numbers.
    """
    standing = on_floor(joints)
    place = place_camera(sensor, standing, np.deg2rad(azimuth_deg))
    height_m = body.body.standing_height(bone_lengths)
    generator = np.random.default_rng(np.random.SeedSequence(seed))
    scene = DepthScene(sensor, body.flesh, body.disturbance, standing, height_m, place, generator)
    return FilmedTake(scene, place, standing)


def simulate_depth(store: Store, request: DepthRequest, folder: Path, progress: Progress) -> SimulatedDepth:
    """Simulate a depth camera that records takes of a store.

    The same request writes the same bytes. The folder appears only when it is complete.

    Parameters
    ----------
    store : Store
        The store.
    request : DepthRequest
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
    body = load_filmed_body(request.body)
    takes = chosen_takes(store, request.takes, request.where)
    outside: dict[str, int] = {}
    frames = 0

    def record(unfinished: Path, name: str, take: str) -> dict[str, Any]:
        nonlocal frames
        filmed = _filmed(store, request, body, take)
        frames += len(filmed.joints)
        if missing := int(filmed.place.outside.sum()):
            outside[name] = missing
        return write_recording(unfinished, name, filmed, store.rate_hz)

    head = (
        f"# Simulated by kinedex: camera {request.camera}, body {Path(request.body).stem!r}, seed {request.seed}.\n"
        "# The truth is for `evaluate_reconstruction` alone.\n"
    )
    shown = write_recordings(folder, takes, head, progress, record)
    return SimulatedDepth(folder, shown, frames, outside)


def _filmed(store: Store, request: DepthRequest, body: FilmedBody, take: str) -> FilmedTake:
    """Return an interval of a take of a store, placed in front of the simulated camera."""
    joints = np.ascontiguousarray(filmed_joints(store, take, JOINTS).transpose(2, 0, 1))
    start, stop = request.interval or (0, len(joints))
    if not 0 <= start < stop <= len(joints):
        asked = "" if request.interval is None else f", not {start}:{stop}"
        raise KinedexError(f"take '{take}' has {len(joints)} frames: film an interval of 0:{len(joints)}{asked}")
    known = np.asarray(np.isfinite(joints).all(axis=(1, 2)))
    if not known[start:stop].all():
        raise KinedexError(f"take '{take}' cannot be filmed: {_way_out(joints, known, start, stop)}")
    seed = [request.seed, zlib.crc32(take.encode())]
    lengths = bone_lengths_of(joints[known])
    return film_take(SENSORS[request.camera], body, joints[start:stop], lengths, request.azimuth_deg, seed)


def _way_out(joints: F64, known: Bool, start: int, stop: int) -> str:
    """Return the end of an error message about a take with unknown joints.

    It names the first frame of the request with an unknown joint, and the longest interval whose joints are all known,
    or says that no frame has all joints.
    """
    first = start + int(np.argmin(known[start:stop]))
    joint = JOINTS[int(np.argmin(np.isfinite(joints[first]).all(axis=1)))]
    ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    intervals = ends.reshape(-1, 2)
    if not len(intervals):
        return f"no frame has all of its joints (frame {first} has no {joint}); film another take"
    begin, end = intervals[int(np.argmax(intervals[:, 1] - intervals[:, 0]))].tolist()
    return f"frame {first} has no {joint}; film an interval whose joints are all known, as --frames {begin}:{end}"


def write_recording(folder: Path, name: str, filmed: FilmedTake, rate_hz: float) -> dict[str, Any]:
    """Write the images, camera and truth of a recording.

    Parameters
    ----------
    folder : Path
        The folder of the recordings; the truth goes into its folder `truth`, which exists.
    name : str
        Name of the recording.
    filmed : FilmedTake
        The take before the camera, of which no image was drawn yet.
    rate_hz : float
        Frames per second.

    Returns
    -------
    dict
        The entry of the recording in the recordings file.
    """
    home, sensor = folder / name, filmed.scene.sensor
    (home / "depth").mkdir(parents=True)
    camera = DepthCamera(
        sensor.matrix, np.zeros(0), sensor.size, UNIT_M, rate_hz,
        rotation=filmed.place.rotation, place=filmed.place.place,
    )  # fmt: skip
    write_camera(home / "camera.yaml", camera)
    write_depth_png(home / "background.png", filmed.scene.background() * UNIT_M, UNIT_M)
    for frame in range(len(filmed.scene)):
        write_depth_png(home / "depth" / f"{frame:06d}.png", filmed.scene.frame(frame) * UNIT_M, UNIT_M)
    write_csv(folder / TRUTH / f"{name}.csv", JointMotion(name, JOINTS, filmed.joints.astype(np.float32), rate_hz))
    return {
        "depth": f"{name}/depth/*.png",
        "camera": f"{name}/camera.yaml",
        "background": f"{name}/background.png",
        "rate_hz": rate_hz,
        "truth": f"{TRUTH}/{name}.csv",
    }
