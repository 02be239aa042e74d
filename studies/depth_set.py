"""Depth recordings of HDM05 by simulated cameras: set D of the design, and sets that parameters are chosen on.

Each recording shows a take of one class. Recordings are made once and kept in `build/studies/depth`, in the files that
`kinedex reconstruct` reads; a folder's name has the camera, the body, the direction and a digest of the simulator.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

import kinedex
from kinedex.catalog.configs import shipped_configs
from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.catalog.filmed_bodies import KIND, load_filmed_body
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.thinned_poses import bone_directions, bone_lengths_of, thin_poses
from kinedex.ops.simulation import depth_rays
from kinedex.ops.simulation.depth_sensors import SENSORS
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.simulation.recording_folder import new_folder
from kinedex.pipelines.simulation.simulated_depth import film_take, write_recording
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.png import read_depth_png
from studies import BUILD

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

RATE_HZ = 30.0
TEST_ACTOR, TEST_SEED = "mm", 100
CHOICE_SEED = 7
ACTORS = ("bd", "bk", "dg", "mm")
_CUT_FRAMES = 2  # a take of set D ends as many frames before its label does, and begins as many after


@dataclass(frozen=True, eq=False)
class Clip:
    """An interval of motion.

    Attributes
    ----------
    name, actor, label : str
        Name of its take, its actor and its class; the class of a whole take of mm is empty.
    joints : float64 array (T, 24, 3)
        The named joints in metres.
    valid : bool array (T,)
        The frames that have a word.
    """

    name: str
    actor: str
    label: str
    joints: F64
    valid: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Film:
    """A way to film: camera, body and direction.

    Attributes
    ----------
    camera, body : str
        Names of `SENSORS`, and of a body of `configs/bodies/filmed`.
    azimuth_deg : float
        Degrees that the camera stands to the person's left.
    """

    camera: str = "tof"
    body: str = "first"
    azimuth_deg: float = 0.0

    @property
    def name(self) -> str:
        """The name in tables and folders."""
        side = "left" if self.azimuth_deg > 0 else "right"
        return "-".join([self.camera, *([self.body] if self.body != "first" else []),
                         *([f"{side}-{abs(self.azimuth_deg):g}"] if self.azimuth_deg else [])])  # fmt: skip


@dataclass(frozen=True, eq=False)
class Filmed:
    """A recording with its truth.

    Attributes
    ----------
    name, actor : str
        Name of the recording, which is its class, and its actor.
    folder : Path
        The folder of its files.
    camera : DepthCamera
        The camera.
    truth : float64 array (T, 24, 3)
        The joints in metres in the axes that bodies are fitted in: x right, y up, z towards the camera, which is at 0.
    """

    name: str
    actor: str
    folder: Path
    camera: DepthCamera
    truth: F64

    @property
    def background(self) -> F32:
        """The empty room (H, W) in metres."""
        return read_depth_png(self.folder / "background.png", self.camera)

    @cached_property
    def images(self) -> list[F32]:
        """The depth images (H, W) in metres."""
        return [read_depth_png(path, self.camera) for path in sorted((self.folder / "depth").glob("*.png"))]


@dataclass(frozen=True, eq=False)
class Archive:
    """A pose database of actors.

    Attributes
    ----------
    actors : tuple of str
        The actors.
    mean_bones : float64 array (24,)
        The mean of their bone lengths in metres.
    directions : float32 array (N, 24, 3)
        Unit directions of the bones of each pose.
    """

    actors: tuple[str, ...]
    mean_bones: F64
    directions: F32


def read_motions(data: Path) -> list[Clip]:
    """Return the clips of bd, bk and dg and the whole takes of mm, in order of their names.

    Parameters
    ----------
    data : Path
        The folder hdm05, with clips and takes.
    """
    found = [_read(path, path.stem.split("_")[1], path.parent.name) for path in (data / "clips").glob("*/*.amc")]
    found += [_read(path, TEST_ACTOR, "") for path in (data / "takes").glob("*.amc")]
    return sorted(found, key=lambda clip: clip.name)


def _read(path: Path, actor: str, label: str) -> Clip:
    take = kinedex.read(path)
    order = [take.joints.index(joint) for joint in JOINTS]
    joints = np.ascontiguousarray(take.positions[:, order], np.float64)
    return Clip(path.stem, actor, label, joints, take.words() != NO_WORD)


def own_bones(motions: Sequence[Clip]) -> dict[str, F64]:
    """Return the median bone lengths (24,) of each actor over all of his frames."""
    return {
        actor: bone_lengths_of(np.concatenate([clip.joints for clip in motions if clip.actor == actor]))
        for actor in dict.fromkeys(clip.actor for clip in motions)
    }


def archive_of(motions: Sequence[Clip], bones: Mapping[str, F64], without: str) -> Archive:
    """Return the pose database of all actors of the clips but one; mm lends poses only to the others' recordings.

    The design's set D has the archive bd, bk, dg, and set D' (actor dg) the archive bd, bk, mm.
    """
    actors = tuple(actor for actor in ACTORS if actor != without)
    mean = np.mean([bones[actor] for actor in actors], axis=0)
    directions = [bone_directions(clip.joints[clip.valid]) for clip in motions if clip.actor in actors]
    every = np.concatenate(directions)
    return Archive(actors, mean, np.ascontiguousarray(every[thin_poses(every, mean).rows]))


def held_out_clips(motions: Sequence[Clip], data: Path) -> list[Clip]:
    """Return the takes of set D: the first interval of each class that the ground truth of mm labels."""
    takes = {clip.name: clip for clip in motions if clip.actor == TEST_ACTOR}
    first: dict[str, Clip] = {}
    with (data / "takes" / "ground_truth.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if row["class"] not in first:
                start, stop = int(row["start"]) // 4 + _CUT_FRAMES, int(row["stop"]) // 4 - _CUT_FRAMES
                take = takes[row["take"]]
                frames = slice(start, stop)
                first[row["class"]] = Clip(take.name, TEST_ACTOR, row["class"], take.joints[frames], take.valid[frames])
    return [first[label] for label in sorted(first)]


def choice_clips(motions: Sequence[Clip], actor: str) -> list[Clip]:
    """Return the takes that parameters are chosen on: the first clip of each class of an actor."""
    first: dict[str, Clip] = {}
    for clip in motions:
        if clip.actor == actor and clip.label:
            first.setdefault(clip.label, clip)
    return [first[label] for label in sorted(first)]


def film_set(clips: Sequence[Clip], bones: Mapping[str, F64], film: Film) -> list[Filmed]:
    """Return the recordings of takes, which are made unless they lie in the folder of the studies.

    Class i of set D is filmed with seed 100 + i, the others all with seed 7.
    """
    (actor,) = {clip.actor for clip in clips}
    folder = BUILD / "depth" / f"{actor}-{film.name}-{_digest(film.body)}"
    if not (folder / "recordings.yaml").is_file():
        _make(folder, clips, bones[actor], film)
    entries = yaml.safe_load((folder / "recordings.yaml").read_text(encoding="utf-8"))["recordings"]
    return [_filmed(folder, name, actor, entry["truth"]) for name, entry in entries.items()]


def _digest(body: str) -> str:
    """Return a digest of what recordings are made with."""
    sources = sorted(Path(depth_rays.__file__).parent.glob("depth_*.py"))
    files = [*sources, shipped_configs() / KIND / f"{body}.yaml", shipped_configs() / "bodies" / "cones20.yaml"]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _make(folder: Path, clips: Sequence[Clip], bones: F64, film: Film) -> None:
    body, sensor = load_filmed_body(film.body), SENSORS[film.camera]
    entries = {}
    with new_folder(folder) as unfinished:
        (unfinished / "truth").mkdir()
        for number, clip in enumerate(clips):
            seed = TEST_SEED + number if clip.actor == TEST_ACTOR else CHOICE_SEED
            filmed = film_take(sensor, body, clip.joints, bones, film.azimuth_deg, [seed])
            entries[clip.label] = write_recording(unfinished, clip.label, filmed, RATE_HZ)
        text = yaml.safe_dump({"recordings": entries}, sort_keys=False)
        (unfinished / "recordings.yaml").write_text(text, encoding="utf-8")


def _filmed(folder: Path, name: str, actor: str, truth: str) -> Filmed:
    camera = read_camera(folder / name / "camera.yaml")
    joints = np.loadtxt(folder / truth, delimiter=",", skiprows=1, ndmin=2)[:, 2:].reshape(-1, len(JOINTS), 3)
    return Filmed(name, actor, folder / name, camera, inside(camera, joints))


def inside(camera: DepthCamera, joints: F64) -> F64:
    """Return joints (T, 24, 3) of the world in the axes that bodies are fitted in, of a level camera."""
    assert camera.rotation is not None
    seen: F64 = (joints - camera.place) @ camera.rotation.T * np.array([1.0, -1.0, -1.0])
    return seen
