"""Keypoints in JSON: files of frames and sequences of files, their sets, persons and times, and what has no depth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.keypoint_sets import keypoint_sets_by_count, load_keypoint_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.keypoint_json import KeypointReader
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from tests.point_files import keypoints_of

ORDER = load_feature_set().joints
AUTO = load_mappings("auto", ORDER)
AT_30 = ReadSettings(rate_hz=30.0)
JOINTS = ("lhip", "rhip", "lknee", "rankle", "lshoulder", "relbow", "lwrist")

COCO_17 = load_keypoint_set("coco-17").order
BODY_25 = load_keypoint_set("body-25").order
HALPE_26 = load_keypoint_set("halpe-26").order
MEDIAPIPE_33 = load_keypoint_set("mediapipe-33").order


def save(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def check(path: Path, walk: np.ndarray, names: tuple[str, ...], given: ReadSettings = AT_30) -> None:
    """The joints that the keypoints are, within a tenth of a millimetre."""
    assert is_motion_file(path)
    body = read_body(path, None, AUTO, ORDER, given)
    sides = {"l": "left", "r": "right"}
    for joint in JOINTS:
        expected = walk[:, names.index(f"{sides[joint[0]]}_{joint[1:]}")].T
        np.testing.assert_allclose(body.positions[ORDER.index(joint)], expected, atol=1e-4)


def openpose(points: np.ndarray, **more: Any) -> dict[str, Any]:
    flat = np.concatenate([points, np.ones((len(points), 1))], axis=1).ravel().tolist()
    return {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": [], "pose_keypoints_3d": flat, **more}]}


@pytest.mark.parametrize("names", [sets[0].order for sets in keypoint_sets_by_count().values()], ids=len)
def test_a_file_of_frames_comes_in_by_the_number_of_its_points(tmp_path: Path, names: tuple[str, ...]) -> None:
    walk = keypoints_of(names, 6)
    path = save(tmp_path / "a.json", {"frames": [{"keypoints_3d": positions.tolist()} for positions in walk]})
    check(path, walk, names)


def test_a_sequence_of_files_is_one_take_and_the_first_file_stands_for_it(tmp_path: Path) -> None:
    walk = keypoints_of(BODY_25, 12)
    for number, positions in enumerate(walk):
        if number != 5:
            save(tmp_path / f"walk_{number:012d}_keypoints.json", openpose(positions))
    save(tmp_path / "walk_000000000005_keypoints.json", {"version": 1.3, "people": []})
    save(tmp_path / "other.json", {"takes": []})
    motions = [path.name for path in sorted(tmp_path.iterdir()) if is_motion_file(path)]
    assert motions == ["walk_000000000000_keypoints.json"]
    check(tmp_path / motions[0], walk, BODY_25)  # nobody in frame 5: a gap of a frame, which is closed


def test_names_times_and_rate_of_a_file_count(tmp_path: Path) -> None:
    walk = keypoints_of(COCO_17, 6)
    turned = [8, *range(8), *range(9, 17)]
    names = [COCO_17[i] for i in turned]
    listed = {
        "fps": 50,
        "keypoint_names": names,
        "frames": [{"keypoints": positions[turned].tolist()} for positions in walk],
    }
    path = save(tmp_path / "a.json", listed)
    check(path, walk, COCO_17, ReadSettings())
    assert read_body(path, None, AUTO, ORDER).rate_hz == 50.0
    timed = [
        {"timestamp_ms": 40 * t, "joints_3d": dict(zip(COCO_17, positions.tolist(), strict=True))}
        for t, positions in enumerate(walk)
    ]
    path = save(tmp_path / "b.json", timed)
    check(path, walk, COCO_17, ReadSettings())
    assert read_body(path, None, AUTO, ORDER).rate_hz == pytest.approx(25.0)


def test_world_landmarks_of_mediapipe_stand_up(tmp_path: Path) -> None:
    walk = keypoints_of(MEDIAPIPE_33, 6)
    about = walk - walk[:, 23:25].mean(axis=1, keepdims=True)
    shown = about * np.array([1, -1, -1])
    frames = [
        {"pose_world_landmarks": [dict(zip("xyz", place, strict=True)) | {"visibility": 0.9} for place in positions]}
        for positions in shown.tolist()
    ]
    path = save(tmp_path / "a.json", {"fps": 30.0, "frames": frames})
    check(path, about, MEDIAPIPE_33)
    assert any("stays in its place" in warning for warning in read_body(path, None, AUTO, ORDER).warnings)


def test_mmpose_names_its_points_and_persons_are_followed_by_their_ids(tmp_path: Path) -> None:
    walk = keypoints_of(HALPE_26, 6)
    instances = [
        {"frame_id": t, "instances": [{"track_id": 7, "keypoints": positions.tolist(), "keypoint_scores": [1.0] * 26}]}
        for t, positions in enumerate(walk)
    ]
    meta = {"keypoint_id2name": {str(i): name for i, name in enumerate(HALPE_26)}}
    check(save(tmp_path / "a.json", {"meta_info": meta, "instance_info": instances}), walk, HALPE_26)
    for frame, positions in zip(instances, walk, strict=True):
        other = {"track_id": 9, "keypoints": (positions + np.array([0, 0, 3])).tolist()}
        frame["instances"] = [other, *frame["instances"]]  # type: ignore[misc]
    path = save(tmp_path / "b.json", {"instance_info": instances})
    reader = reader_of(path)
    assert reader.persons(MotionFile(path), AUTO) == ("9", "7")
    first = reader.read(MotionFile(path, person="7"), AUTO, ORDER, AT_30)
    second = reader.read(MotionFile(path, person="9"), AUTO, ORDER, AT_30)
    np.testing.assert_allclose((second.positions - first.positions)[ORDER.index("lknee"), 2], 3.0, atol=1e-6)


def test_keypoints_without_depth_are_refused_with_the_way_on(tmp_path: Path) -> None:
    flat = {"people": [{"person_id": [-1], "pose_keypoints_2d": [500.0, 400.0, 0.9] * 25}]}
    scored = {"instance_info": [{"instances": [{"keypoints": [[500.0, 400.0, 0.9]] * 17}]}]}
    pairs = {"frames": [{"keypoints_3d": [[1.0, 2.0]] * 17}]}
    for content in (flat, scored, pairs, {"frames": [{"pose_landmarks": [{"x": 0.5, "y": 0.5, "z": 0.1}] * 33}]}):
        path = save(tmp_path / "a.json", content)
        assert is_motion_file(path)
        with pytest.raises(SourceError, match=r"frame 0: holds keypoints of one image, without depth: lift them to 3D"):
            read_body(path, None, AUTO, ORDER, AT_30)


def test_faults_are_refused_with_their_frame(tmp_path: Path) -> None:
    walk = keypoints_of(COCO_17, 3).tolist()
    two = openpose(keypoints_of(BODY_25, 1)[0])
    two["people"] *= 2
    for content, words in (
        (two, "frame 0 has 2 persons without an id each"),
        ({"frames": [{"keypoints_3d": walk[0][:16]}]}, "frame 0 has 16 points without names; of 17, 18, 25, 26, 33"),
        (
            {"frames": [{"keypoints_3d": walk[0]}, {"keypoints_3d": keypoints_of(BODY_25, 1)[0].tolist()}]},
            "frame 1 has",
        ),
        ({"frames": [{"keypoints_3d": [["a", 0, 0]] * 17}]}, "frame 0: expected points of x, y and z"),
        ({"frames": [{"keypoints_3d": [[1e300, 0, 0]] * 17}]}, "frame 0: expected points of x, y and z, within"),
        ({"frames": [{}, {"pose_keypoints_3d": []}]}, "no person in any frame"),
        ({"fps": 1e9, "frames": [{"keypoints_3d": place} for place in walk]}, "the rate must be"),
        ({"frames": [{"keypoints_3d": place} for place in walk]}, "does not state its frames per second"),
        ({"takes": 3}, "frame 0: expected keypoints under one of"),
    ):
        with pytest.raises(SourceError, match=words):
            read_body(save(tmp_path / "a.json", content), None, AUTO, ORDER)
    for text, words in (
        ("{", "is not JSON"),
        ("[" * 100_000, "is no JSON that can be read"),
        ("9" * 5000, "list of frames"),
    ):
        (tmp_path / "a.json").write_text(text)
        with pytest.raises(SourceError, match=words):
            read_body(tmp_path / "a.json", None, AUTO, ORDER)


def test_other_json_is_no_motion_file(tmp_path: Path) -> None:
    for content in ({"takes": []}, [], {"annotations": [{"keypoints": [1, 2, 3]}]}, {"name": "people"}, {"frames": []}):
        assert not is_motion_file(save(tmp_path / "a.json", content))


def test_openpose_in_the_wild_has_no_depth_and_is_one_sequence_a_camera(shared: Path) -> None:
    for folder in sorted((shared / "data" / "cameras").glob("balancing/*/pose/*_json")):
        files = sorted(folder.glob("*.json"))
        assert [path for path in files if KeypointReader().sniff(path)] == files[:1]
        with pytest.raises(SourceError, match="without depth"):
            read_body(files[0], None, AUTO, ORDER)
