"""Files of a small recording for tests: four cameras around a body that steps aside, in any format."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from kinedex.catalog.cameras import Camera
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.body.axisangle import vectors

SIZE = (640, 480)
LENS = (-0.08, 0.03, 0.001, -0.0005)

JOINTS = {
    "nose": (0, 1.6, 0.12), "left_eye": (0.03, 1.63, 0.1), "right_eye": (-0.03, 1.63, 0.1), "left_ear": (0.07, 1.62, 0),
    "right_ear": (-0.07, 1.62, 0), "left_shoulder": (0.18, 1.4, 0), "right_shoulder": (-0.18, 1.4, 0),
    "left_elbow": (0.25, 1.13, 0), "right_elbow": (-0.25, 1.13, 0.02), "left_wrist": (0.27, 0.9, 0.1),
    "right_wrist": (-0.27, 0.9, 0.1), "left_hip": (0.1, 0.92, 0), "right_hip": (-0.1, 0.92, 0),
    "left_knee": (0.1, 0.5, 0.02), "right_knee": (-0.1, 0.5, 0.02), "left_ankle": (0.1, 0.08, 0),
    "right_ankle": (-0.1, 0.08, 0),
}  # fmt: skip
"""A standing body of COCO's keypoints, in metres with Y up."""


def cameras(count: int = 4) -> list[Camera]:
    """Cameras in a ring of 4 m, 2 to 2.6 m high, that look at 1 m of height."""
    found = []
    for v in range(count):
        angle = 2 * np.pi * v / count + 0.3
        centre = np.array([4 * np.sin(angle), 2 + 0.2 * v, 4 * np.cos(angle)])
        forward = np.array([0, 1.0, 0]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 1.0, 0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        matrix = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
        found.append(Camera(f"cam_{v + 1}", matrix, np.array(LENS), rotation, -rotation @ centre, SIZE))
    return found


def body(frames: int = 3) -> np.ndarray:
    """Return the keypoints (T, 17, 3) of the body, which steps aside by 5 cm a frame."""
    points = np.array([JOINTS[name] for name in load_keypoint_set("coco-17").order])
    return points + 0.05 * np.arange(frames)[:, None, None] * np.array([1.0, 0, 0])


@dataclass
class Filmed:
    """A recording that is written into a folder, and the keys of its entry in recordings.yaml."""

    folder: Path
    cameras: list[Camera] = field(default_factory=cameras)
    points: np.ndarray = field(default_factory=body)
    entry: dict[str, Any] = field(default_factory=dict)

    @property
    def pixels(self) -> np.ndarray:
        """Keypoints (T, V, P, 2) in the images."""
        return np.stack([camera.project(self.points)[0] for camera in self.cameras], axis=1)

    def write(self, **changed: Any) -> Path:
        """Write recordings.yaml with a recording `step`, whose keys are changed; None removes one."""
        entry = {"cameras": "calib.toml", "keypoints": "pose/{camera}/*.json", "rate_hz": 30, "unit": "m", "up": "y"}
        entry = {key: value for key, value in {**entry, **self.entry, **changed}.items() if value is not None}
        path = self.folder / "recordings.yaml"
        path.write_text(yaml.safe_dump({"recordings": {"step": entry}}, sort_keys=False), encoding="utf-8")
        return path


def filmed(folder: Path, **changed: Any) -> Filmed:
    """Write a recording with a calibration in TOML and keypoints of OpenPose."""
    found = Filmed(folder, **changed)
    (folder / "calib.toml").write_text(toml(found.cameras), encoding="utf-8")
    for v, camera in enumerate(found.cameras):
        for t, places in enumerate(found.pixels[:, v]):
            save_json(folder / "pose" / camera.name / f"{camera.name}_{t:012d}_keypoints.json", openpose([places]))
    return found


def toml(found: list[Camera], more: str = "") -> str:
    """Return a calibration as AniPose writes it."""
    text = ""
    for camera in found:
        values = {"name": camera.name, "size": list(camera.size), "matrix": camera.matrix.tolist()}
        values |= {"distortions": camera.distortion.tolist(), "rotation": vectors(camera.rotation[None])[0].tolist()}
        values |= {"translation": camera.translation.tolist()}
        text += f"[{camera.name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()) + more
    return text + "[metadata]\nadjusted = false\n"


def opencv(camera: Camera) -> dict[str, Any]:
    """Return a camera with the keys of OpenCV's samples."""
    width, height = camera.size
    return {
        "image_width": width, "image_height": height, "camera_matrix": camera.matrix.tolist(),
        "dist_coeffs": [*camera.distortion.tolist(), 0.0], "R": camera.rotation.tolist(),
        "T": camera.translation.reshape(3, 1).tolist(),
    }  # fmt: skip


def opencv_yaml(camera: Camera) -> str:
    """Return a camera as cv::FileStorage writes it."""
    text = f"%YAML:1.0\n---\nimage_width: {camera.size[0]}\nimage_height: {camera.size[1]}\n"
    for key, values in (
        ("camera_matrix", camera.matrix), ("dist_coeffs", np.append(camera.distortion, 0.0)[:, None]),
        ("rvec", vectors(camera.rotation[None])[0][:, None]), ("tvec", camera.translation[:, None]),
    ):  # fmt: skip
        text += f"{key}: !!opencv-matrix\n   rows: {len(values)}\n   cols: {values.shape[1]}\n   dt: d\n"
        text += f"   data: [ {', '.join(map(repr, values.ravel().tolist()))} ]\n"
    return text


def easymocap(found: list[Camera], sizes: bool = True, vectors_too: bool = True) -> dict[str, str]:
    """Return the two files of a calibration as EasyMocap writes them, by their names."""
    names = "names:\r\n" + "".join(f'  - "{camera.name}"\r\n' for camera in found)
    lenses = places = f"%YAML:1.0\r\n---\r\n{names}"
    for camera in found:
        width, height = camera.size
        lenses += _matrix(f"K_{camera.name}", camera.matrix)
        lenses += _matrix(f"dist_{camera.name}", np.append(camera.distortion, 0.0)[None])
        lenses += f"H_{camera.name}: {height}\r\nW_{camera.name}: {width}\r\n" if sizes else ""
        if vectors_too:
            places += _matrix(f"R_{camera.name}", vectors(camera.rotation[None])[0][:, None])
        places += _matrix(f"Rot_{camera.name}", camera.rotation) + _matrix(
            f"T_{camera.name}", camera.translation[:, None]
        )
    return {"intri.yml": lenses, "extri.yml": places}


def _matrix(key: str, values: np.ndarray) -> str:
    data = ", ".join(f"{value:.12f}" for value in values.ravel())
    shape = f"  rows: {len(values)}\r\n  cols: {values.shape[1]}\r\n  dt: d\r\n"
    return f"{key}: !!opencv-matrix\r\n{shape}  data: [{data}]\r\n"


def panoptic(found: list[Camera]) -> dict[str, Any]:
    """Return cameras in the form of CMU Panoptic, centimetres with -Y up."""
    turned = [camera.in_world(np.diag([1.0, -1, -1]), 100.0) for camera in found]
    entries = [
        {
            "name": camera.name, "type": "hd", "resolution": list(camera.size), "K": camera.matrix.tolist(),
            "distCoef": [*camera.distortion.tolist(), 0.0], "R": camera.rotation.tolist(),
            "t": camera.translation.reshape(3, 1).tolist(),
        }
        for camera in turned
    ]  # fmt: skip
    return {"calibDataSource": "160906_calib", "cameras": entries}


def openpose(persons: list[np.ndarray], confidence: float | None = 0.9) -> dict[str, Any]:
    """Return the persons of a frame in OpenPose's form."""
    people = []
    for places in persons:
        rows = [[None if np.isnan(x) else float(x) for x in place] + [confidence] for place in places]
        people.append({"person_id": [-1], "pose_keypoints_2d": [number for row in rows for number in row]})
    return {"version": 1.3, "people": people}


def mmpose(persons: list[np.ndarray], confidence: float = 0.9) -> list[dict[str, Any]]:
    """Return the instances of a frame in MMPose's form."""
    return [
        {
            "keypoints": places.tolist(), "keypoint_scores": [confidence] * len(places),
            "bbox": [[0.0, 0.0, 9.0, 9.0]], "bbox_score": 0.98,
        }
        for places in persons
    ]  # fmt: skip


def save_json(path: Path, content: Any) -> Path:
    """Write JSON into a folder that need not exist."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path
