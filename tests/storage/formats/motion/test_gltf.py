"""glTF files: the body is that of the same motion as BVH, however the file is laid out, and bad files are refused."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.storage.formats.motion.bvh_parser import Bvh, parse_bvh
from kinedex.storage.formats.motion.figures import FigureReader
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import reader_of
from tests.bvh_files import Joint, bvh_text, dance, mixamo
from tests.gltf_files import Builder, dancing_gltf

FEATURES = load_feature_set()
JOINTS = FEATURES.joints
AUTO = load_mappings("auto", JOINTS)


def read(path: Path, person: str = "") -> Body:
    return reader_of(path).read(MotionFile(path, person=person), AUTO, JOINTS, ReadSettings())


def persons(path: Path) -> tuple[str, ...]:
    return reader_of(path).persons(MotionFile(path), AUTO)


def twin(tmp_path: Path, root: Joint, frames: int = 12, seed: int = 0) -> Body:
    """The same motion as BVH."""
    path = tmp_path / f"twin{seed}.bvh"
    path.write_text(bvh_text(root, dance(root, frames, seed)))
    return read(path)


def assert_same(body: Body, expected: Body, within_m: float = 1e-5) -> None:
    np.testing.assert_allclose(body.positions, expected.positions, atol=within_m)
    np.testing.assert_allclose(body.orientation, expected.orientation, atol=1e-5)
    np.testing.assert_array_equal(analyse(body, FEATURES, 30.0)[2], analyse(expected, FEATURES, 30.0)[2])


@pytest.mark.parametrize("skin", [True, False])
def test_a_clip_is_the_motion_of_the_same_bvh(tmp_path: Path, skin: bool) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 12), skin=skin)
    (tmp_path / "a.glb").write_bytes(document.glb())
    (tmp_path / "b.gltf").write_bytes(document.gltf())
    (tmp_path / "c.gltf").write_bytes(document.gltf("c%20d.bin"))
    (tmp_path / "c d.bin").write_bytes(document.binary)
    for name in ("a.glb", "b.gltf", "c.gltf"):
        body = read(tmp_path / name)
        assert (body.rate_hz, body.unit, body.skeleton, body.frames) == (30.0, "1 m", "mixamo", 12)
        assert_same(body, twin(tmp_path, mixamo()))
        assert persons(tmp_path / name) == ()
    assert any("sampled at 30 Hz" in sentence for sentence in body.evidence)


def test_what_a_library_writes_is_read(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    path = tmp_path / "a.glb"
    path.write_bytes(dancing_gltf(mixamo(), dance(mixamo(), 12)).glb())
    document = pygltflib.GLTF2().load(str(path))
    document.save(str(tmp_path / "b.glb"))
    document.convert_buffers(pygltflib.BufferFormat.DATAURI)
    document.save(str(tmp_path / "c.gltf"))
    document.convert_buffers(pygltflib.BufferFormat.BINFILE)
    document.save(str(tmp_path / "d.gltf"))
    for name in ("b.glb", "c.gltf", "d.gltf"):
        assert_same(read(tmp_path / name), twin(tmp_path, mixamo()))


def test_nodes_above_the_skeleton_move_it(tmp_path: Path) -> None:
    """An armature that is turned, scaled and moved, as converters from centimetres with Z up leave it."""
    document = Builder()
    positions = document.nodes(mixamo(), scale=1.0)
    document.clip("dance", positions, mixamo(), dance(mixamo(), 12), scale=1.0)
    document.json["skins"] = [{"joints": list(positions.values())}]
    half = np.sqrt(0.5)
    turned = {"rotation": [-half, 0, 0, half], "scale": [0.01] * 3, "children": [len(positions) + 1]}
    back = [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1]  # a matrix, columns first: Y to Z
    document.json["nodes"] += [turned, {"name": "Armature", "matrix": back, "children": [positions["mixamorig:Hips"]]}]
    (tmp_path / "a.glb").write_bytes(document.glb())
    assert_same(read(tmp_path / "a.glb"), twin(tmp_path, mixamo()))


def test_rest_turns_of_nodes_do_not_count_as_turns_of_the_body(tmp_path: Path) -> None:
    """Joints whose own axes are turned at rest, as Blender's bones are, give the same body."""
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    half = np.sqrt(0.5)
    nodes = document.json["nodes"]
    top = document.json["skins"][0]["joints"][0]
    # the hips hang turned by 90 degrees, and their children are turned back
    for child in nodes[top]["children"]:
        x, y, z = nodes[child]["translation"]
        nodes[child]["translation"] = [x, z, -y]
    document.json["nodes"] = nodes
    clip = document.json["animations"][0]
    times = clip["samplers"][0]["input"]
    turn = np.array([half, 0, 0, half])
    for channel in clip["channels"]:
        node, path = channel["target"]["node"], channel["target"]["path"]
        if path != "rotation" or (node != top and node not in nodes[top]["children"]):
            continue
        sampler = clip["samplers"][channel["sampler"]]
        before = values_of(document, sampler["output"])
        after = [product(q, turn) if node == top else product(conjugate(turn), q) for q in before]
        sampler["output"] = document.accessor(np.array(after))
        assert sampler["input"] == times
    nodes[top]["rotation"] = turn.tolist()
    for child in nodes[top]["children"]:
        nodes[child]["rotation"] = conjugate(turn).tolist()
    (tmp_path / "a.glb").write_bytes(document.glb())
    assert_same(read(tmp_path / "a.glb"), twin(tmp_path, mixamo()))


def test_the_rest_pose_is_that_of_binding_where_the_scene_is_in_another(tmp_path: Path) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    positions = np.zeros((len(mixamo().all()), 3))
    names = [joint.name for joint in mixamo().all()]
    for joint in mixamo().all():
        for child in joint.children:
            positions[names.index(child.name)] = positions[names.index(joint.name)] + 0.01 * np.array(child.offset)
    matrices = np.tile(np.eye(4), (len(names), 1, 1))
    # the mesh was bound with Z up, in centimetres, and somewhere else
    matrices[:, :3, :3] = 0.01 * np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    matrices[:, :3, 3] = -positions - [0.0, 1.0, 0.0]
    skin = document.json["skins"][0]
    skin["inverseBindMatrices"] = document.accessor(matrices.transpose(0, 2, 1).reshape(-1, 16))
    for node in document.json["nodes"]:
        node["rotation"] = [0.1, 0.2, 0.15, 0.9631]
    path = tmp_path / "a.glb"
    path.write_bytes(document.glb())
    reader = reader_of(path)
    assert isinstance(reader, FigureReader)
    figure = reader.figure(MotionFile(path), ReadSettings())
    np.testing.assert_allclose(figure.rest - figure.rest[0], positions, atol=1e-6)
    assert "its rest pose is the pose of binding" in figure.evidence
    assert_same(read(path), twin(tmp_path, mixamo()))


def values_of(document: Builder, index: int, width: int = 4) -> np.ndarray:
    view = document.json["bufferViews"][document.json["accessors"][index]["bufferView"]]
    data = document.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(data, "<f4").reshape(-1, width).astype(float)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([*(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])), a[3] * b[3] - a[:3] @ b[:3]])


def conjugate(q: np.ndarray) -> np.ndarray:
    return q * [-1, -1, -1, 1]


def test_clips_and_figures_are_takes_of_their_own(tmp_path: Path) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    positions = {node["name"]: i for i, node in enumerate(document.json["nodes"])}
    document.clip("jump", positions, mixamo(), dance(mixamo(), 5, seed=3))
    path = tmp_path / "clips.glb"
    path.write_bytes(document.glb())
    assert persons(path) == ("dance", "jump")
    assert [read(path, name).frames for name in persons(path)] == [12, 5]
    assert_same(read(path, "jump"), twin(tmp_path, mixamo(), 5, seed=3))
    with pytest.raises(SourceError, match="holds 2 figures or clips: 'dance', 'jump'"):
        read(path)

    document = dancing_gltf(mixamo("a:"), dance(mixamo("a:"), 12))
    other = document.nodes(mixamo("b:"))
    document.json["skins"].append({"joints": list(other.values())})
    document.clip("duet", other, mixamo("b:"), dance(mixamo("b:"), 7, seed=1))
    path = tmp_path / "two.glb"
    path.write_bytes(document.glb())
    assert persons(path) == ("a:Hips dance", "b:Hips duet")
    assert_same(read(path, "b:Hips duet"), twin(tmp_path, mixamo("b:"), 7, seed=1))


def test_skins_of_one_skeleton_are_one_figure(tmp_path: Path) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    joints = document.json["skins"][0]["joints"]
    document.json["skins"] = [{"joints": joints[:9]}, {"joints": joints[5:]}, {"joints": joints[12:13]}]
    (tmp_path / "a.glb").write_bytes(document.glb())
    assert persons(tmp_path / "a.glb") == ()
    assert_same(read(tmp_path / "a.glb"), twin(tmp_path, mixamo()))


def test_interpolations_agree_where_they_must(tmp_path: Path) -> None:
    """STEP and CUBICSPLINE through the same keys have the same poses at these."""
    for interpolation in ("STEP", "CUBICSPLINE"):
        document = dancing_gltf(mixamo(), dance(mixamo(), 12))
        for sampler in document.json["animations"][0]["samplers"]:
            sampler["interpolation"] = interpolation
            entry = document.json["accessors"][sampler["output"]]
            if interpolation == "CUBICSPLINE":
                view = document.json["bufferViews"][entry["bufferView"]]
                data = document.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
                values = np.frombuffer(data, "<f4").reshape(12, -1)
                keys = np.stack([values + 9, values, values - 9], axis=1).reshape(36, -1)
                sampler["output"] = document.accessor(keys)
        path = tmp_path / f"{interpolation}.glb"
        path.write_bytes(document.glb())
        assert_same(read(path), twin(tmp_path, mixamo()))


def test_numbers_come_strided_sparse_and_as_small_integers(tmp_path: Path) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    samplers = document.json["animations"][0]["samplers"]
    rotations = values_of(document, samplers[0]["output"])
    rows = np.zeros((12, 6), "<f4")
    rows[:, 1:5] = rotations
    strided = {"bufferView": document.view(rows.tobytes(), byteStride=24), "byteOffset": 4, "componentType": 5126}
    document.json["accessors"].append(strided | {"count": 12, "type": "VEC4"})
    samplers[0]["output"] = len(document.json["accessors"]) - 1
    rotations = values_of(document, samplers[1]["output"])
    sparse = {
        "count": 12,
        "indices": {"bufferView": document.view(np.arange(12, dtype="u1").tobytes()), "componentType": 5121},
        "values": {"bufferView": document.view(rotations.astype("<f4").tobytes())},
    }
    document.json["accessors"].append({"componentType": 5126, "count": 12, "type": "VEC4", "sparse": sparse})
    samplers[1]["output"] = len(document.json["accessors"]) - 1
    rotations = values_of(document, samplers[2]["output"])
    samplers[2]["output"] = document.accessor(np.round(rotations * 32767), "i2", normalized=True)
    (tmp_path / "a.glb").write_bytes(document.glb())
    np.testing.assert_allclose(read(tmp_path / "a.glb").positions, twin(tmp_path, mixamo()).positions, atol=2e-4)


@pytest.mark.parametrize("rate_hz", [24.0, 30.0, 60.0, 120.0])
def test_the_rate_is_that_of_the_keys(tmp_path: Path, rate_hz: float) -> None:
    (tmp_path / "a.glb").write_bytes(dancing_gltf(mixamo(), dance(mixamo(), 30), rate_hz=rate_hz).glb())
    body = read(tmp_path / "a.glb")
    assert (body.rate_hz, body.frames) == (rate_hz, 30)


def test_keys_at_odd_times_are_sampled_with_a_warning(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(dancing_gltf(mixamo(), dance(mixamo(), 30), rate_hz=31.7).glb())
    body = read(tmp_path / "a.glb")
    assert body.rate_hz == pytest.approx(31.7, abs=0.01)
    assert any("no usual rate" in warning for warning in body.warnings)


def test_a_file_in_centimetres_is_found_out(tmp_path: Path) -> None:
    document = Builder()
    document.clip("dance", document.nodes(mixamo(), scale=1.0), mixamo(), dance(mixamo(), 12), scale=1.0)
    (tmp_path / "a.glb").write_bytes(document.glb())
    body = read(tmp_path / "a.glb")
    assert body.unit == "0.01 m (guessed)"
    assert any("it is read in cm" in warning for warning in body.warnings)
    np.testing.assert_allclose(body.positions, twin(tmp_path, mixamo()).positions, atol=1e-5)


def broken(change: Callable[[dict[str, Any]], object]) -> bytes:
    document = dancing_gltf(mixamo(), dance(mixamo(), 4))
    document.gltf()
    change(document.json)
    return json.dumps(document.json).encode()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda j: j.pop("asset"), "its JSON has no `asset`"),
        (lambda j: j["asset"].update(version="1.0"), r"asset.version must be 2.x, got '1.0'"),
        (lambda j: j.pop("animations"), "holds no animations"),
        (lambda j: j["nodes"][3].update(rotation=[1, 2]), r"nodes\.3\.rotation"),
        (lambda j: j["nodes"][3].update(children=[0]), "children|circle|another parent"),
        (lambda j: j["nodes"][0].update(children=[1, 1]), "nodes.0.children must be nodes without another parent"),
        (lambda j: j["skins"][0].update(joints=[999]), "skins.joints must be nodes below"),
        (lambda j: j["accessors"][0].update(count=10**9), "has 1000000000 numbers"),
        (lambda j: j["accessors"][0].update(count=100), "needs 400 bytes of bufferViews"),
        (lambda j: j["accessors"][0].update(componentType=1), "componentType must be one of"),
        (lambda j: j["accessors"][1].update(type="VEC3"), "must be of type VEC4, got VEC3"),
        (lambda j: j["accessors"][1].update(count=3), "must have 1 values for each of 4 keys, got 3"),
        (lambda j: j["bufferViews"][0].update(buffer=3), "names buffers.3, which is not there"),
        (lambda j: j["buffers"][0].update(uri="data:;base64,@@@"), "is no base64"),
        (lambda j: j["buffers"][0].update(uri="data:text/plain,abc"), "must be base64"),
        (lambda j: j["buffers"][0].pop("uri"), "has no uri"),
        (lambda j: j["buffers"][0].update(uri="none.bin"), "which is not there"),
        (lambda j: j["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}}), "packed with EXT_meshopt"),
    ],
)
def test_damaged_files_are_refused_with_the_key(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / "a.gltf"
    path.write_bytes(broken(change))
    with pytest.raises(SourceError, match=message):
        read(path)


@pytest.mark.parametrize(
    "uri",
    ["../out.bin", "/etc/passwd", "file:///etc/passwd", "http://example.org/a.bin", "a/../../out.bin", "..%2Fout.bin",
     "link.bin", "\\\\host\\a.bin", "C:\\a.bin"],
)  # fmt: skip
def test_nothing_outside_of_the_folder_is_read(tmp_path: Path, uri: str) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    document = dancing_gltf(mixamo(), dance(mixamo(), 4))
    (tmp_path / "out.bin").write_bytes(document.binary)
    (folder / "link.bin").symlink_to(tmp_path / "out.bin")
    (folder / "a.gltf").write_bytes(document.gltf(uri))
    with pytest.raises(SourceError, match="must name a file in the same folder or below"):
        read(folder / "a.gltf")


def test_times_that_would_make_endless_motion_are_refused(tmp_path: Path) -> None:
    document = dancing_gltf(mixamo(), dance(mixamo(), 4))
    times = document.accessor(np.array([0.0, 1.0, 2.0, 1e9]))
    for sampler in document.json["animations"][0]["samplers"]:
        sampler["input"] = times
    (tmp_path / "a.glb").write_bytes(document.glb())
    with pytest.raises(SourceError, match="a time must be wrong"):
        read(tmp_path / "a.glb")


def test_a_file_that_is_cut_anywhere_is_refused(tmp_path: Path) -> None:
    data = dancing_gltf(mixamo(), dance(mixamo(), 4)).glb()
    path = tmp_path / "a.glb"
    for stop in (0, 3, 12, 30, 1000, len(data) // 2, len(data) - 400):
        path.write_bytes(data[:stop])
        with pytest.raises(SourceError):
            read(path)


def test_avatars_are_known_by_the_names_of_vrm(tmp_path: Path) -> None:
    bones = {
        "hips": "Hips", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2", "neck": "Neck", "head": "Head",
        **{f"{side.lower()}{bone}": f"{side}{name}" for side in ("Left", "Right") for bone, name in (
            ("UpperLeg", "UpLeg"), ("LowerLeg", "Leg"), ("Foot", "Foot"), ("Toes", "ToeBase"), ("Shoulder", "Shoulder"),
            ("UpperArm", "Arm"), ("LowerArm", "ForeArm"), ("Hand", "Hand"), ("MiddleProximal", "HandMiddle1"),
        )},
    }  # fmt: skip
    document = dancing_gltf(mixamo(""), dance(mixamo(""), 12))
    positions = {node["name"]: i for i, node in enumerate(document.json["nodes"])}
    human = {bone: {"node": positions[name]} for bone, name in bones.items()}
    for node in document.json["nodes"]:
        node["name"] = "J_Bip_" + str(len(node["name"]))
    document.json["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": human}}}
    path = tmp_path / "a.vrm"
    path.write_bytes(document.glb())
    body, expected = read(path), twin(tmp_path, mixamo(""))
    for joint in ("root", "lknee", "rankle", "lelbow", "rwrist", "head"):
        at = JOINTS.index(joint)
        np.testing.assert_allclose(body.positions[at], expected.positions[at], atol=1e-5)


def test_avatars_of_vrm_0_are_turned_to_face_ahead(tmp_path: Path) -> None:
    """Their axes are those of glTF turned by half about Y."""
    document = dancing_gltf(mixamo(), dance(mixamo(), 12))
    for node in document.json["nodes"]:
        x, y, z = node["translation"]
        node["translation"] = [-x, y, -z]
    clip = document.json["animations"][0]
    for channel in clip["channels"]:
        sampler = clip["samplers"][channel["sampler"]]
        width = 3 if channel["target"]["path"] == "translation" else 4
        values = values_of(document, sampler["output"], width)
        sampler["output"] = document.accessor(values * ([-1, 1, -1] if width == 3 else [-1, 1, -1, 1]))
    positions = {node["name"].removeprefix("mixamorig:"): i for i, node in enumerate(document.json["nodes"])}
    bones = [{"bone": "hips", "node": positions["Hips"]}, *({"bone": name, "node": i} for name, i in positions.items())]
    document.json["extensions"] = {"VRM": {"humanoid": {"humanBones": bones[1:]}}}
    (tmp_path / "a.vrm").write_bytes(document.glb())
    assert_same(read(tmp_path / "a.vrm"), twin(tmp_path, mixamo()))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("pattern", "unit"), [("bandai/dataset-2/*.bvh", 0.01), ("cmu/same_take_amc_and_bvh/*.bvh", 0.0254 / 0.45)]
)
def test_takes_of_others_are_the_same_as_gltf(tmp_path: Path, shared: Path, pattern: str, unit: float) -> None:
    source = min((shared / "data").glob(pattern))
    (tmp_path / "take.glb").write_bytes(scene_of(parse_bvh(source), 240, unit).glb())
    body, expected = read(tmp_path / "take.glb"), read(source)
    assert body.skeleton == expected.skeleton
    np.testing.assert_allclose(body.positions, expected.positions[..., :240], atol=1e-4)
    np.testing.assert_allclose(body.orientation, expected.orientation[:, :240], atol=1e-4)
    lost = [warning for warning in expected.warnings if "have no length in the file" in warning]
    assert set(lost) <= set(body.warnings)


def scene_of(bvh: Bvh, frames: int, unit: float) -> Builder:
    """The nodes and the first frames of a BVH file as a scene."""
    document = Builder()
    clip: dict[str, Any] = {"name": "take", "channels": [], "samplers": []}
    channels = bvh.channels[:frames]
    times = document.accessor(np.arange(len(channels)) / bvh.rate_hz)
    for i, node in enumerate(bvh.nodes):
        rotations, moved = np.tile(np.eye(3), (len(channels), 1, 1)), np.tile(node.before, (len(channels), 1))
        for step in node.steps:
            track = channels[:, step.column]
            if step.kind >= kinematics.MOVE_X:
                moved[:, step.kind - kinematics.MOVE_X] += track
            else:
                rotations = rotations @ np.array(
                    [kinematics.rotation(step.kind, degrees) for degrees in np.rad2deg(track)]
                )
        w, x, y, z = kinematics.quaternions(rotations.reshape(-1, 9).T)
        document.channel(clip, i, "rotation", times, document.accessor(np.stack([x, y, z, w], axis=1)))
        document.channel(clip, i, "translation", times, document.accessor(unit * moved))
        below = [k for k, other in enumerate(bvh.nodes) if other.parent == i]
        entry = {"name": node.name, "translation": (unit * moved[0]).tolist()}
        document.json["nodes"].append(entry | ({"children": below} if below else {}))
    document.json["animations"] = [clip]
    return document


def test_memory_stays_below_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(dancing_gltf(mixamo(), dance(mixamo(), 600)).glb())
    extent = reader_of(path).extent(MotionFile(path), len(JOINTS), ReadSettings())
    assert (extent.frames, extent.rate_hz) == (600, 30.0)
    read(path)
    tracemalloc.start()
    try:
        read(path)
        assert tracemalloc.get_traced_memory()[1] < extent.bytes
    finally:
        tracemalloc.stop()
