"""Files of depth recordings for the fuzzer: small valid ones of every format, and what must hold of what is read."""

from __future__ import annotations

import io
import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.clouds import Cloud, cloud_depths, fitted_matrix
from kinedex.storage.formats.depth.frame_files import find_frames
from kinedex.storage.formats.depth.frames import open_raw
from kinedex.storage.formats.depth.npz import camera_of_npz, npz_values, open_npz
from kinedex.storage.formats.depth.pcd import read_pcd, read_ply
from kinedex.storage.formats.depth.png import read_depth_png
from tests.depth_files import SIZE, camera, cloud_points, pcd, ply, room

SEEN = camera()
DEPTHS = room(SEEN)
POINTS = cloud_points(SEEN, DEPTHS)[: 8 * SIZE[0]]

PCD_WORDS = (
    b"WIDTH 1000000000\n", b"HEIGHT 0\n", b"POINTS 256\n", b"DATA binary_compressed\n", b"DATA ascii\n",
    b"SIZE 8 8 8\n", b"TYPE I U F\n", b"FIELDS z y x\n", b"FIELDS x y z rgb\n", b"COLUMNS x y z\n", b"VERSION .7\n",
)  # fmt: skip
PLY_WORDS = (
    b"element vertex 1000000000\n", b"property list uchar int x\n", b"format binary_big_endian 1.0\n", b"end_header\n",
    b"property double y\n", b"element face 3\n", b"comment x\n", b"obj_info\n", b"property uchar z\n",
)  # fmt: skip
CAMERA_WORDS = (
    b"pose: {rotation: [[1,0,0],[0,1,0],[0,0,1]], place: [0,0,0]}\n", b"up: [0, -1, 0]\n", b"range: true\n",
    b"distortion: [0.1, 0.2, 0, 0, 1, 1, 1, 1]\n", b'"coeffs": [1,1,0,0,0],', b'"model": "Inverse Brown Conrady",',
    b'"depth_scale": 1e-300,', b'"CalibrationInformation": {"Cameras": [{"Location": "D0"}]},', b'"width": 1e9,',
)  # fmt: skip
LIST_WORDS = (
    b"1.5 ../a.png\n",
    b"nan a.png\n",
    b"1e300 a.png\n",
    b"# list\n",
    b"2.0 /etc/a.png\n",
    b"1.5 a.png b.png\n",
)


def png_images() -> dict[str, bytes]:
    """A depth image."""
    file = io.BytesIO()
    Image.fromarray(np.round(1000 * DEPTHS).astype(np.uint16)).save(file, "PNG")
    return {"depth": file.getvalue()}


def npz_images() -> dict[str, bytes]:
    """Integers with a matrix, and floats with numbers."""
    found = {}
    for name, arrays in (
        ("integers", {"depth": np.round(1000 * DEPTHS[None]).astype(np.uint16), "intrinsics": SEEN.matrix}),
        ("floats", {"depth": np.stack([DEPTHS] * 2), "fx": 28.0, "fy": 28.0, "cx": 15.5, "cy": 11.5, "rate_hz": 30.0}),
    ):
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        found[name] = file.getvalue()
    return found


def raw_images() -> dict[str, bytes]:
    """Two images."""
    return {"two": 2 * np.round(1000 * DEPTHS).astype("<u2").tobytes()}


def pcd_clouds() -> dict[str, bytes]:
    """Every encoding, organised and with a colour."""
    found = {name: pcd(POINTS, name, (SIZE[0], 8)) for name in ("ascii", "binary", "binary_compressed")}
    return found | {"colour": pcd(POINTS, "binary_compressed", None, colour=True)}


def ply_clouds() -> dict[str, bytes]:
    """Every encoding, with other properties and a face."""
    found = {name: ply(POINTS, name, more=True) for name in ("ascii", "binary_big_endian")}
    return found | {"plain": ply(POINTS, "binary_little_endian")}


def yaml_cameras() -> dict[str, bytes]:
    """A camera with a pose, and one with a lens and an accelerometer."""
    base = {"width": 32, "height": 24, "fx": 28.0, "fy": 28.0, "cx": 15.5, "cy": 11.5, "depth_unit_m": 0.001}
    pose = {"rotation": np.eye(3).tolist(), "place": [0.0, 1.0, 2.0]}
    lens = {"distortion": [0.1, 0.01, 0.001, 0.0], "up": [0.0, -9.8, 0.1], "range": True, "rate_hz": 30}
    return {name: yaml.safe_dump(base | more).encode() for name, more in (("pose", {"pose": pose}), ("lens", lens))}


def json_cameras() -> dict[str, bytes]:
    """Intrinsics of RealSense, Open3D and Azure Kinect."""
    realsense = {"width": 32, "height": 24, "ppx": 15.5, "ppy": 11.5, "fx": 28.0, "fy": 28.0, "model": "Brown Conrady"}
    realsense |= {"coeffs": [0.0] * 5, "depth_scale": 0.001}
    open3d = {"width": 32, "height": 24, "intrinsic_matrix": SEEN.matrix.T.ravel().tolist(), "depth_scale": 1000}
    lens = {"ModelType": "BrownConrady", "ModelParameters": [0.5, 0.5, 0.5, 0.5, 1, 1, 0, 1, 1, 0, 0, 0, 0.001, 0.002]}
    azure = {"CalibrationInformation": {"Cameras": [{"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": lens}]}}
    named = {"realsense": realsense, "open3d": open3d, "azure": azure}
    return {name: json.dumps(content).encode() for name, content in named.items()}


def text_cameras() -> dict[str, bytes]:
    """Intrinsics of TUM RGB-D."""
    return {"tum": b"# fx fy cx cy\n525.0 525.0 319.5 239.5\n"}


def frame_lists() -> dict[str, bytes]:
    """The list of TUM RGB-D."""
    lines = "".join(f"{1305031102.16 + t / 30:.6f} depth/{t}.png\n" for t in range(20))
    return {"tum": f"# depth maps\n{lines}".encode()}


def recordings() -> dict[str, bytes]:
    """A recording with every key."""
    entry = {"depth": "a/*.png", "camera": "a.yaml", "background": "auto", "rate_hz": 30, "body": "estimate"}
    entry |= {"depth_unit_m": 0.001, "truth": "a.csv", "markers": {"LWRIST": "lwrist"}}
    entry |= {"truth_pose": {"rotation": np.eye(3).tolist(), "place": [0.0, 0.0, 0.0]}}
    return {"one": yaml.safe_dump({"recordings": {"a": entry}}).encode()}


def _check_depths(depths: np.ndarray, seen: DepthCamera) -> None:
    assert depths.shape == seen.size[::-1]
    assert depths.dtype == np.float32
    assert ((depths >= 0) & (depths <= 1.01e6)).all()


def check_png(path: Path) -> None:
    """An image has the camera's size, and no depth below 0."""
    _check_depths(read_depth_png(path, SEEN), SEEN)


def check_npz(path: Path) -> None:
    """The images that the file states can be read in any order."""
    seen = camera_of_npz(path, npz_values(path)) or SEEN
    frames = open_npz(path, seen)
    for number in (frames.numbers[-1], 0):
        _check_depths(frames.read(number), seen)


def check_raw(path: Path) -> None:
    """The images that the size gives can be read."""
    frames = open_raw(path, SEEN)
    _check_depths(frames.read(frames.numbers[-1]), SEEN)


def _check_cloud(cloud: Cloud) -> None:
    known = np.isfinite(cloud.points[:, 2])
    assert (cloud.points[known, 2] > 0).all()
    seen = SEEN if cloud.size is None else camera(size=cloud.size)
    _check_depths(cloud_depths(cloud, seen), seen)
    with suppress(SourceError):
        assert np.isfinite(fitted_matrix(cloud)).all()


def check_pcd(path: Path) -> None:
    """A cloud's points lie before the camera, and become an image."""
    _check_cloud(read_pcd(path))


def check_ply(path: Path) -> None:
    """A cloud's points lie before the camera, and become an image."""
    _check_cloud(read_ply(path))


def check_camera(path: Path) -> None:
    """A camera projects, and converts an image."""
    found = read_camera(path, (640, 576))
    found.project([[0.0, 0.0, 1.0], [1.0, 1.0, 2.0]])
    assert found.upwards is None or abs(float(np.linalg.norm(found.upwards)) - 1) < 1e-6
    if found.size == SIZE:
        _check_depths(found.depths(np.full(SIZE[::-1], 1000, np.uint16)), found)


def check_list(path: Path) -> None:
    """The files of a list lie below its folder, in the order of their times."""
    found = find_frames(path.parent, path.name)
    assert all(path.parent in one.parents and ".." not in one.parts for one in found.files)
    assert found.times is not None
    assert (np.diff(found.times) > 0).all()
    with suppress(SourceError):
        assert len(found.numbers(30.0)) == len(found.files)


def check_recordings(path: Path) -> None:
    """Recordings have names that can be those of takes."""
    for name, entry in load_depth_recordings(path).recordings.items():
        f"{name}{entry.depth}{entry.camera}{entry.body}{entry.truth}".encode()
