"""Files of camera recordings for the fuzzer: small valid ones of every format, and what must hold of what is read."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import polars as pl
import yaml
from PIL import Image

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.catalog.configs import load_yaml
from kinedex.catalog.keypoint_sets import parse_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.storage.formats.cameras.calibrations import in_metres, read_calibration
from kinedex.storage.formats.cameras.keypoint_files import keypoint_arrays
from kinedex.storage.formats.cameras.keypoint_tables import read_keypoint_table
from kinedex.storage.formats.cameras.masks import mask_arrays, open_bits, read_mask
from kinedex.storage.formats.cameras.openpose import read_coco_results, read_frame, read_mmpose
from kinedex.storage.formats.cameras.persons import SeenPersons, chosen_persons
from tests.camera_files import Filmed, body, cameras, easymocap, mmpose, opencv, opencv_yaml, openpose, panoptic, toml

RING = cameras(2)
PIXELS = Filmed(Path(), RING, body(2)).pixels
MASK_SIZE = (64, 48)

CALIBRATION_WORDS = (
    b"camera_matrix: ", b"!!opencv-matrix\n   rows: 3\n   cols: 3\n", b"rvec: [0, 0, 0]\n", b"fisheye = true\n",
    b"size = [640, 480]\n", b"[cam_1]\n", b'"K":[[1,0,0],[0,1,0],[0,0,1]],', b'"cameras":', b"%YAML:1.0\n---\n",
    b"K_1: ", b"R_1: ", b"T_1: ", b"W_1: 640\n", b"names: [1]\n",
)  # fmt: skip
TABLE_WORDS = (
    b"camera,frame,keypoint,x,y,confidence\n",
    b"person,",
    b",nan,",
    b"sep=;\n",
    b"recording,",
    b'"',
    b"1e9,",
)


def yaml_calibrations() -> dict[str, bytes]:
    """One camera as OpenCV writes it, and several in sections."""
    sections = yaml.safe_dump({one.name: opencv(one) for one in RING})
    return {"one": opencv_yaml(RING[0]).encode(), "sections": sections.encode()}


def easymocap_calibrations() -> dict[str, bytes]:
    """Both files of EasyMocap in one, with sizes and without vectors."""
    head = "%YAML:1.0\r\n---\r\n"
    texts = easymocap(RING), easymocap(RING, sizes=False, vectors_too=False)
    both = [(one["intri.yml"] + one["extri.yml"].removeprefix(head)).encode() for one in texts]
    return {name: text.replace(b"names:", b"_:", 1) for name, text in zip(("sizes", "matrices"), both, strict=True)}


def json_calibrations() -> dict[str, bytes]:
    """A list of cameras, and the form of CMU Panoptic."""
    listed = {"cameras": [{"name": one.name, **opencv(one)} for one in RING]}
    return {"list": json.dumps(listed).encode(), "panoptic": json.dumps(panoptic(RING)).encode()}


def toml_calibrations() -> dict[str, bytes]:
    """Cameras of AniPose and of Pose2Sim."""
    return {"anipose": toml(RING).encode(), "pose2sim": toml(RING, "fisheye = false\n").encode()}


def openpose_frames() -> dict[str, bytes]:
    """A person, two of them, and nobody."""
    two = openpose([PIXELS[0, 0], PIXELS[1, 1]])
    return {
        "one": json.dumps(openpose([PIXELS[0, 0]])).encode(),
        "two": json.dumps(two).encode(),
        "none": json.dumps(openpose([])).encode(),
    }


def mmpose_files() -> dict[str, bytes]:
    """The frames of a video with their header, and a list of frames."""
    frames = [{"frame_id": t, "instances": mmpose([one, one + 5])} for t, one in enumerate(PIXELS[:, 0])]
    header = {"keypoint_id2name": {str(number): f"point_{number}" for number in range(16)} | {"16": "nose"}}
    contents = {"video": {"meta_info": header, "instance_info": frames}, "list": frames}
    return {name: json.dumps(content).encode() for name, content in contents.items()}


def coco_results() -> dict[str, bytes]:
    """Two frames by number, and by the name of the image."""
    found = {}
    for name, image in (("numbers", "{}"), ("names", "frame_{}.png")):
        entries = [
            {
                "image_id": image.format(t),
                "keypoints": np.append(one, np.ones((17, 1)), axis=1).round(2).ravel().tolist(),
            }
            for t, one in enumerate(PIXELS[:, 0])
        ]
        found[name] = json.dumps(entries).encode()
    return found


def _table() -> pl.DataFrame:
    frame, view, point = (index.ravel() for index in np.indices(PIXELS.shape[:3]))
    x, y = PIXELS.reshape(-1, 2).T.round(2)
    return pl.DataFrame({"camera": view, "frame": frame, "keypoint": point, "x": x, "y": y, "confidence": 0.9})


def csv_tables() -> dict[str, bytes]:
    """Keypoints by number, and by name with persons."""
    named = _table().with_columns(pl.lit("nose").alias("keypoint"), pl.col("keypoint").alias("person"))
    return {"numbers": _table().write_csv().encode(), "named": named.write_csv(separator=";").encode()}


def parquet_tables() -> dict[str, bytes]:
    """The same table as Parquet."""
    file = io.BytesIO()
    _table().write_parquet(file)
    return {"numbers": file.getvalue()}


def png_masks() -> dict[str, bytes]:
    """A grey mask, one of a bit, and one of colours."""
    mask = np.zeros(MASK_SIZE[::-1], np.uint8)
    mask[10:40, 20:30] = 255
    found = {}
    for mode in ("L", "1", "RGB"):
        file = io.BytesIO()
        Image.fromarray(mask).convert(mode).save(file, "PNG")
        found[mode] = file.getvalue()
    return found


def packed_masks() -> dict[str, bytes]:
    """Packed bits of two cameras at a tenth of their size."""
    bits = np.packbits(np.arange(2 * MASK_SIZE[1] * MASK_SIZE[0]).reshape(2, MASK_SIZE[1], -1) % 7 == 0, axis=2)
    file = io.BytesIO()
    np.savez_compressed(file, cam_1=bits, cam_2=bits)
    return {"two": file.getvalue()}


def recordings() -> dict[str, bytes]:
    """A recording by cameras, and a track of the store."""
    entry = {"cameras": "a.toml", "keypoints": "p/{camera}/*.json", "rate_hz": 60, "offsets": {"a": 1}, "cuts": [3]}
    entry |= {"up": "z", "unit": "mm", "size": [640, 480], "person": "largest", "body": "estimate"}
    return {"cameras": yaml.safe_dump({"recordings": {"a": entry, "b": {"track": "c"}}}).encode()}


def check_calibration(path: Path) -> None:
    """Cameras are finite, and project and see."""
    calibration = read_calibration(path, (640, 480))
    for camera in in_metres(calibration, calibration.unit or "m", calibration.up or "y"):
        assert np.isfinite(camera.centre).all()
        camera.project([[0.0, 1.0, 0.0], [1.0, 0.0, 3.0]])
        lengths = np.linalg.norm(camera.directions([[0.0, 0.0], [320.0, 240.0]]), axis=1)
        assert (np.isnan(lengths) | (np.abs(lengths - 1) < 1e-9)).all()
        camera.name.encode()


def _check_persons(seen: SeenPersons) -> None:
    for choice in ("largest", "most_confident"):
        chosen_persons(seen, choice)
    found = keypoint_arrays([seen, None], None, "largest", [0, 0])
    assert ((found.confidence >= 0) & (found.confidence <= 1)).all()
    assert (np.isfinite(found.pixels[..., 0]) | (found.confidence == 0)).all()
    assert found.pixels.shape == (*found.confidence.shape, 2)
    "".join([*found.names, *found.unused]).encode()


def check_openpose(path: Path) -> None:
    """A frame's persons become arrays, if there are any."""
    persons = read_frame(path)
    if persons:
        _check_persons(SeenPersons(path, {0: persons}))


def check_mmpose(path: Path) -> None:
    """Persons become arrays, if there are any."""
    seen = read_mmpose([path])
    if seen.keypoints:
        _check_persons(seen)


def check_coco_results(path: Path) -> None:
    """Results become arrays."""
    _check_persons(read_coco_results(path))


def check_keypoint_table(path: Path) -> None:
    """The rows of every camera become arrays."""
    for seen in read_keypoint_table(path).values():
        _check_persons(seen)


def check_mask(path: Path) -> None:
    """A mask has the size that it was asked for."""
    assert read_mask(path, MASK_SIZE).shape == MASK_SIZE[::-1]


def check_packed_masks(path: Path) -> None:
    """Packed masks unpack to 0 and 255."""
    for name in mask_arrays(path):
        masks = open_bits(path, name, RING[0])
        found = masks.read(0)
        assert found is not None
        assert found.shape == masks.size[::-1]
        assert set(np.unique(found).tolist()) <= {0, 255}


def check_recordings(path: Path) -> None:
    """Recordings have names that can be those of takes."""
    for name, recording in load_recordings(path).recordings.items():
        assert "/" not in name
        assert recording.track or (recording.rate_hz or 0) > 0


def check_keypoint_set(path: Path) -> None:
    """Keypoints lie on a body."""
    chain = load_kinematic_chain()
    found = parse_keypoint_set(load_yaml(path), chain)
    points = found.body_points(list(found.positions), ChainBody(chain, np.zeros((len(chain.joints), 3))))
    assert np.isfinite(points.offsets).all()
