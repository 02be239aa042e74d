"""Choose the takes that are simulated, and write the folder of their recordings whole or not at all."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.keypoint_sets import KeypointSet
from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.kinematic_chain import vector_of
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import KinedexError
from kinedex.ops.simulation.cameras import CameraRing
from kinedex.ops.simulation.recording import SimulatedRecording
from kinedex.ops.tracking.body_mask import render_mask
from kinedex.ops.tracking.views import camera_view
from kinedex.storage.disk import TEMPORARY
from kinedex.storage.formats.labels.formats import file_names
from kinedex.storage.store.store import Store

_FORBIDDEN = re.compile(r"[^\w.+-]")
_MOST_LETTERS = 90


def chosen_takes(store: Store, takes: Sequence[str], where: str | None) -> list[str]:
    """Return the names of the takes that are named or selected, in the store's order.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects further ones.

    Raises
    ------
    KinedexError
        There is no such take, or nothing is selected.
    """
    for name in takes:
        store.take_id(name)
    selected = set(store.takes_table(where)["name"].to_pylist()) if where is not None else set()
    if where is not None and not selected:
        raise KinedexError(f"the filter `{where}` selects no take of {store.path}")
    if not takes and where is None:
        raise KinedexError("no take is named; name takes, or select them with --where \"class = 'walk'\"")
    wanted = selected | set(takes)
    return [name for name in store.takes_table(None)["name"].to_pylist() if name in wanted]


def recording_names(takes: Sequence[str]) -> list[str]:
    """Return a name for the recording of each take, which is also the name of its folder.

    Letters, digits and . + - are kept, other characters become underscores.
    """
    plain = [(_FORBIDDEN.sub("_", take)[:_MOST_LETTERS]).lstrip(".+-") or "take" for take in takes]
    twice = {name.casefold() for name in plain if sum(one.casefold() == name.casefold() for one in plain) > 1}
    numbered = [f"{name}-{i + 1}" if name.casefold() in twice else name for i, name in enumerate(plain)]
    return [name.replace("~", "-") for name in file_names(numbered)]


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Write a folder completely or not at all.

    Parameters
    ----------
    folder : Path
        A folder that does not exist, or is empty.

    Yields
    ------
    Path
        A temporary folder to write to, which is renamed when the block ends, and removed if the block fails.

    Raises
    ------
    KinedexError
        The folder cannot be written.
    """
    unfinished = folder.absolute().parent / f"{TEMPORARY}{uuid.uuid4().hex}"
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        if folder.is_dir():
            folder.rmdir()
        os.replace(unfinished, folder)
    except OSError as fault:
        raise KinedexError(f"{folder}: cannot be written: {fault.strerror}; nothing was written") from None
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def require_new(folder: Path) -> None:
    """Raise an error if a folder contains files.

    Raises
    ------
    KinedexError
        The path is a folder with files, or not a folder.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise KinedexError(f"{folder}: is no folder; give a new one with -o")
    if folder.is_dir() and any(folder.iterdir()):
        raise KinedexError(
            f"{folder}: is not empty, and recordings are never overwritten; give a new folder, such as "
            f"-o {_free_name(folder)}"
        )


def _free_name(folder: Path) -> Path:
    """Return the first of `NAME-2`, `NAME-3`, … that does not exist beside a folder."""
    absolute = folder.absolute()
    numbers = (number for number in itertools.count(2) if not absolute.with_name(f"{absolute.name}-{number}").exists())
    return folder.parent / f"{absolute.name}-{next(numbers)}"


F64 = npt.NDArray[np.float64]

MASK_PART = 2
"""The factor by which masks are smaller than the images, if it divides width and height."""


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


def write_masks(home: Path, ring: CameraRing, made: SimulatedRecording, positions: F64) -> str:
    """Write a mask for each frame and camera, except for frames in which a camera is blank.

    Parameters
    ----------
    home : Path
        The folder of the recording.
    ring : CameraRing
        The cameras.
    made : SimulatedRecording
        The recording.
    positions : float64 array (J, 3, T)
        The joints of the chain in metres.

    Returns
    -------
    str
        The path of the files, as written in the recordings file.
    """
    from PIL import Image

    body = measured_body(load_kinematic_chain(), positions)
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
