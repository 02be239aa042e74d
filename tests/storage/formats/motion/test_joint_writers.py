"""Files of the 24 joints, TRC, C3D and glTF, are read by kinedex and by the libraries of others as they were meant."""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import load_yaml
from kinedex.library.new_takes import read
from kinedex.library.take import Take
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import NO_WORD
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.c3d_writer import write_c3d
from kinedex.storage.formats.motion.gltf_writer import write_gltf
from kinedex.storage.formats.motion.joint_motion import MARKER_NAMES, JointMotion
from kinedex.storage.formats.motion.table_writer import write_trc
from tests.bodies import standing
from tests.oracles.features import JOINTS

Writer = Callable[[Path, JointMotion], None]
WRITERS: dict[str, tuple[Writer, float]] = {
    "trc": (write_trc, 0.0),
    "c3d": (write_c3d, 1e-6),
    "glb": (write_gltf, 2e-6),
}
"""Ending → writer, and the largest error in metres."""


def walking(frames: int = 60) -> Take:
    """A figure that walks, swings its limbs and turns."""
    rng = np.random.default_rng(1)
    swing = 0.02 * np.sin(np.linspace(0.0, 20.0, frames) + rng.uniform(0, 6, (24, 3, 1)))
    positions = standing(frames) + swing
    angle = np.linspace(0.0, 4.0, frames)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    positions[:, [0, 2]] = np.einsum("abt,jbt->jat", turn, positions[:, [0, 2]])
    positions[:, 2] += np.linspace(0.0, 3.0, frames)
    return Take.from_positions(positions.transpose(2, 0, 1), 30.0)


def motion_of(take: Take) -> JointMotion:
    return JointMotion("walk 1", JOINTS, take.positions, take.rate_hz, take.words())


def with_gaps(motion: JointMotion) -> JointMotion:
    """The motion without any joint in some frames, and without a knee in another."""
    positions = motion.positions.copy()
    positions[20:35] = np.nan
    positions[40, JOINTS.index("lknee")] = np.nan
    return dataclasses.replace(motion, positions=positions)


@pytest.mark.parametrize("ending", WRITERS)
def test_words_and_places_come_back(ending: str, tmp_path: Path) -> None:
    take = walking()
    write, error = WRITERS[ending]
    for name in ("a", "b"):
        write(tmp_path / f"{name}.{ending}", motion_of(take))
    assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    again = read(tmp_path / f"a.{ending}")
    assert again.info["source_rate_hz"] == 30.0
    assert again.info["skeleton"] in ("named", "named-markers", "named-markers-c3d")
    np.testing.assert_allclose(again.positions, take.positions, atol=error, rtol=0)
    np.testing.assert_array_equal(again.words(), take.words())


@pytest.mark.parametrize("ending", ["trc", "c3d"])
def test_gaps_stay_gaps_in_files_of_markers(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    WRITERS[ending][0](path, with_gaps(motion_of(walking())))
    again = read(path)
    assert np.flatnonzero(again.words() == NO_WORD).tolist() == list(range(20, 35))
    assert "lknee" not in again.warnings[0]


@pytest.mark.parametrize("ending", WRITERS)
def test_joints_that_are_never_seen_are_left_out(ending: str, tmp_path: Path) -> None:
    motion = motion_of(walking())
    positions = motion.positions.copy()
    positions[:, [JOINTS.index(name) for name in ("ltoes", "rtoes", "rclavicle")]] = np.nan
    path = tmp_path / f"a.{ending}"
    WRITERS[ending][0](path, dataclasses.replace(motion, positions=positions))
    text = path.read_bytes()
    for name in ("ltoes", "rclavicle"):
        assert (name if ending == "glb" else MARKER_NAMES[name]).encode() not in text
    again = read(path)
    kept = [JOINTS.index(name) for name in ("root", "lknee", "rankle", "neck", "lelbow", "rwrist")]
    np.testing.assert_allclose(again.positions[:, kept], positions[:, kept], atol=1e-5)


def test_a_gltf_with_gaps_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KinedexError, match=r"invalid in 16 of its 60 frames.*Export csv, trc or c3d"):
        write_gltf(tmp_path / "a.glb", with_gaps(motion_of(walking())))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", WRITERS)
def test_a_motion_without_any_joint_is_refused(ending: str, tmp_path: Path) -> None:
    empty = dataclasses.replace(motion_of(walking()), positions=np.full((3, 24, 3), np.nan, np.float32))
    with pytest.raises(KinedexError, match="'walk 1' has no"):
        WRITERS[ending][0](tmp_path / "a", empty)


def test_the_mappings_of_exported_markers_have_their_names() -> None:
    for name in ("named-markers", "named-markers-c3d"):
        joints = load_yaml(Path("configs/skeletons") / f"{name}.yaml").data["joints"]
        assert {joint: node[0] if isinstance(node, list) else node for joint, node in joints.items()} == MARKER_NAMES
    assert list(MARKER_NAMES) == list(JOINT_PARENTS)


def test_a_trc_has_the_lines_that_opensim_expects(tmp_path: Path) -> None:
    write_trc(tmp_path / "a.trc", dataclasses.replace(with_gaps(motion_of(walking())), name="a\tb\n"))
    lines = (tmp_path / "a.trc").read_text().split("\n")
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\ta_b_.trc"
    assert dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True)) == {
        "DataRate": "30", "CameraRate": "30", "NumFrames": "60", "NumMarkers": "24", "Units": "m",
        "OrigDataRate": "30", "OrigDataStartFrame": "1", "OrigNumFrames": "60",
    }  # fmt: skip
    assert [cell for cell in lines[3].split("\t") if cell] == ["Frame#", "Time", *MARKER_NAMES.values()]
    assert lines[4].split("\t")[2:6] == ["X1", "Y1", "Z1", "X2"]
    assert lines[5] == ""
    rows = [line.split("\t") for line in lines[6:-1]]
    assert {len(row) for row in rows} == {2 + 3 * 24 + 1}
    assert rows[20] == ["21", "0.666667", *[""] * 73]


def test_a_c3d_is_read_by_other_libraries_with_equal_numbers(tmp_path: Path) -> None:
    ezc3d, c3d = pytest.importorskip("ezc3d"), pytest.importorskip("c3d")
    motion = with_gaps(motion_of(walking()))
    motion.positions[50, 0] = 0.0  # would be taken for a point that was not seen
    path = tmp_path / "a.c3d"
    write_c3d(path, motion)
    ours = parse_c3d(path)
    assert (ours.names, ours.rate_hz, ours.unit_m, ours.up) == (tuple(MARKER_NAMES.values()), 30.0, 0.001, "y")
    np.testing.assert_allclose(ours.positions.transpose(2, 0, 1) / 1000, motion.positions, atol=1e-6)
    other = ezc3d.c3d(str(path))
    np.testing.assert_array_equal(other["data"]["points"][:3].transpose(1, 0, 2), ours.positions)
    about = other["parameters"]["POINT"]
    assert about["LABELS"]["value"] == list(MARKER_NAMES.values())
    assert about["DESCRIPTIONS"]["value"][2] == "joint lknee of kinedex"
    assert [about[key]["value"][0] for key in ("UNITS", "X_SCREEN", "Y_SCREEN", "RATE")] == ["mm", "+X", "+Y", 30.0]
    with path.open("rb") as file, pytest.warns(UserWarning, match="No analog data"):
        frames = np.array([points for _, points, _ in c3d.Reader(file).read_frames()])
    seen = np.isfinite(motion.positions).all(axis=2)
    np.testing.assert_array_equal(frames[seen, :3], ours.positions.transpose(2, 0, 1)[seen])
    assert (frames[~seen, 3] == -1).all()


def test_a_c3d_of_more_frames_than_16_bits_count_is_whole(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    positions = np.random.default_rng(0).normal(size=(70_001, 3, 3)).astype(np.float32)
    path = tmp_path / "long.c3d"
    write_c3d(path, JointMotion("long", ("root", "lhip", "rhip"), positions, 120.0))
    ours = parse_c3d(path)
    assert (ours.positions.shape, ours.warnings) == ((3, 3, 70_001), [])
    np.testing.assert_allclose(ours.positions.transpose(2, 0, 1) / 1000, positions, atol=1e-6)
    np.testing.assert_array_equal(ezc3d.c3d(str(path))["data"]["points"][:3].transpose(1, 0, 2), ours.positions)


def test_a_glb_keeps_the_rules_of_the_specification(tmp_path: Path) -> None:
    """The rules on lengths, alignment, bounds and indices of glTF 2.0, sections 3.6, 3.7, 3.11 and 4.4."""
    path = tmp_path / "a.glb"
    write_gltf(path, motion_of(walking()))
    data = path.read_bytes()
    magic, version, length, json_bytes, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, json_bytes % 4, kind) == (b"glTF", 2, len(data), 0, b"JSON")
    content = json.loads(data[20 : 20 + json_bytes])
    binary_bytes, kind = struct.unpack("<I4s", data[20 + json_bytes : 28 + json_bytes])
    assert (kind, binary_bytes) == (b"BIN\0", content["buffers"][0]["byteLength"])
    assert len(data) == 28 + json_bytes + binary_bytes
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
    kinds = {5126: "<f4", 5123: "<u2", 5121: "u1"}
    values = []
    for accessor in content["accessors"]:
        view = content["bufferViews"][accessor["bufferView"]]
        kind = np.dtype(kinds[accessor["componentType"]])
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == accessor["count"] * widths[accessor["type"]] * kind.itemsize
        begin = 28 + json_bytes + view["byteOffset"]
        values.append(np.frombuffer(data[begin : begin + view["byteLength"]], kind).reshape(accessor["count"], -1))
        if "min" in accessor:
            assert accessor["min"] == values[-1].min(axis=0).tolist()
            assert accessor["max"] == values[-1].max(axis=0).tolist()
    for sampler in content["animations"][0]["samplers"]:
        times = content["accessors"][sampler["input"]]
        assert times["min"] == [0.0]
        assert times["count"] == content["accessors"][sampler["output"]]["count"] == 60
    rotations = values[content["animations"][0]["samplers"][-1]["output"]]
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=1), 1.0, atol=1e-6)
    primitives = content["meshes"][0]["primitives"]
    corners = content["accessors"][primitives[0]["attributes"]["POSITION"]]["count"]
    assert sum(content["accessors"][one["indices"]]["count"] for one in primitives) == 3 * (24 * 8 + 23 * 24)
    assert all(values[one["indices"]].max() < corners for one in primitives)
    assert content["scenes"][0]["nodes"] == [content["skins"][0]["skeleton"], 24]


def test_a_library_reads_a_glb(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    path = tmp_path / "a.glb"
    write_gltf(path, motion_of(walking()))
    document = pygltflib.GLTF2().load(str(path))
    assert [node.name for node in document.nodes] == [*JOINT_PARENTS, "figure"]
    document.save(str(tmp_path / "b.glb"))
    np.testing.assert_array_equal(read(tmp_path / "b.glb").words(), walking().words())
