"""Write the files of simulated cameras: calibration, keypoints, and masks of the body."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.keypoint_sets import KeypointSet
from kinedex.catalog.kinematics import load_surface
from kinedex.ops.arrays import F64
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.kinematic_chain import ChainBody, vector_of
from kinedex.ops.simulation.recording import CameraRing, SimulatedRecording
from kinedex.ops.tracking.views import camera_view, render_mask

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
