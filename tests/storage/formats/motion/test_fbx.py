"""FBX files: the body is that of the same motion as BVH, binary or as text, and bad files are refused."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.fbx import clips_of, figure_of, rest_of, skeletons
from kinedex.storage.formats.motion.fbx_scene import ORDERS, Scene, SceneNode, rotations_of
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import reader_of
from tests.bvh_files import Joint, bvh_text, dance, mixamo
from tests.fbx_files import TICKS, Builder, Part, dancing_fbx, properties

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


def assert_same(body: Body, expected: Body) -> None:
    np.testing.assert_allclose(body.positions, expected.positions, atol=1e-5)
    np.testing.assert_allclose(body.orientation, expected.orientation, atol=1e-5)
    np.testing.assert_array_equal(analyse(body, FEATURES, 30.0)[2], analyse(expected, FEATURES, 30.0)[2])


def test_a_clip_is_the_motion_of_the_same_bvh(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 12))
    files = {
        "old": scene.binary(7300), "new": scene.binary(7700), "plain": scene.binary(7400, packed=False),
        "text": scene.text(),
    }  # fmt: skip
    for name, data in files.items():
        path = tmp_path / f"{name}.fbx"
        path.write_bytes(data)
        body = read(path)
        assert (body.rate_hz, body.unit, body.skeleton, body.frames) == (30.0, "1 m", "mixamo", 12)
        assert_same(body, twin(tmp_path, mixamo()))
        assert persons(path) == ()
    assert any("y as up and z as front, and a unit of 1 cm" in sentence for sentence in body.evidence)


def test_axes_and_unit_are_those_that_the_file_states(tmp_path: Path) -> None:
    """A scene with Z up and −Y ahead in inches, its figure turned to stand in it."""
    scene = Builder(UpAxis=[2], FrontAxis=[1], FrontAxisSign=[-1], UnitScaleFactor=[2.54])
    turned = scene.add("Model", "Armature", "Null", properties(Lcl_Rotation=[90, 0, 0], Lcl_Scaling=[1 / 2.54] * 3))
    scene.clip("dance", scene.bones(mixamo(), above=turned), mixamo(), dance(mixamo(), 12))
    (tmp_path / "a.fbx").write_bytes(scene.binary())
    assert_same(read(tmp_path / "a.fbx"), twin(tmp_path, mixamo()))


def test_a_scene_whose_nodes_rest_in_a_pose_turns_as_it_should(tmp_path: Path) -> None:
    """Exporters leave the nodes in any pose of a clip; hips and spine tell how the root is turned in it."""
    scene = dancing_fbx(mixamo(), dance(mixamo(), 12))
    for part in scene.objects.below:
        if part.name == "Model":
            given = part.below[0].below
            given.append(Part("P", ("Lcl Rotation", "Number", "", "A", 20.0, -35.0, 12.0)))
    (tmp_path / "a.fbx").write_bytes(scene.binary())
    assert_same(read(tmp_path / "a.fbx"), twin(tmp_path, mixamo()))


def test_a_bind_pose_is_the_rest_pose(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 12))
    positions: dict[int, np.ndarray] = {}
    numbers = {part.values[1][1]: part.values[0] for part in scene.objects.below if part.name == "Model"}

    def place(joint: Joint, above: np.ndarray) -> None:
        positions[numbers[joint.name]] = above + np.array(joint.offset)
        for child in joint.children:
            place(child, positions[numbers[joint.name]])

    place(mixamo(), np.zeros(3))
    entries = []
    for number, at in positions.items():
        matrix = np.eye(4)
        matrix[3, :3] = at
        entries.append(Part("PoseNode", (), [Part("Node", (number,)), Part("Matrix", (matrix.ravel(),))]))
    scene.objects.below.append(Part("Pose", (9, ("Pose", "bind"), "BindPose"), entries))
    for part in scene.objects.below:
        if part.name == "Model":
            part.below[0].below.append(Part("P", ("Lcl Rotation", "Number", "", "A", 20.0, -35.0, 12.0)))
    for name, data in (("a", scene.binary()), ("b", scene.text())):
        (tmp_path / f"{name}.fbx").write_bytes(data)
        body = read(tmp_path / f"{name}.fbx")
        assert "its rest pose is the pose of binding" in body.evidence
        assert_same(body, twin(tmp_path, mixamo()))


def test_a_pivot_is_the_point_that_a_node_turns_about() -> None:
    """A turn by 90 degrees about Z, at the point (1, 0, 0): the node's origin comes to (1, −1, 0)."""
    node = SceneNode("a", "LimbNode", points={"RotationPivot": np.array([1.0, 0.0, 0.0])})
    linear, place = node.local(np.zeros((1, 3)), np.array([[0.0, 0.0, 90.0]]), np.ones((1, 3)))
    np.testing.assert_allclose(place, [[1, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(linear[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    node.points = {"PreRotation": np.array([0.0, 0.0, 30.0]), "PostRotation": np.array([0.0, 0.0, -20.0])}
    linear, _ = node.local(np.zeros((1, 3)), np.array([[0.0, 0.0, 40.0]]), np.full((1, 3), 2.0))
    np.testing.assert_allclose(linear[0], 2 * kinematics.rotation(2, 90.0), atol=1e-12)  # 30 + 40 + 20 degrees
    for order in ORDERS:
        turned = rotations_of(np.array([[10.0, 20.0, 30.0]]), order)[0]
        degrees = {"X": 10.0, "Y": 20.0, "Z": 30.0}
        np.testing.assert_allclose(turned, kinematics.euler(tuple(degrees[a] for a in order), order), atol=1e-12)


def test_clips_and_figures_are_takes_of_their_own(tmp_path: Path) -> None:
    scene = Builder()
    first, second = scene.bones(mixamo("a:")), scene.bones(mixamo("b:"))
    scene.clip("walk", first, mixamo("a:"), dance(mixamo("a:"), 12))
    layer = scene.clip("duet", first, mixamo("a:"), dance(mixamo("a:"), 5, seed=3))
    times = np.array([round(TICKS * t / 30) for t in range(5)])
    scene.curves(layer, second["b:Hips"], "Lcl Translation", times, {"X": [0.0, 1.0, 2.0, 3.0, 4.0]})
    path = tmp_path / "a.fbx"
    path.write_bytes(scene.binary())
    assert persons(path) == ("a:Hips walk", "a:Hips duet", "b:Hips duet")
    assert_same(read(path, "a:Hips duet"), twin(tmp_path, mixamo("a:"), 5, seed=3))
    with pytest.raises(SourceError, match="holds 3 figures or clips"):
        read(path)


@pytest.mark.parametrize(("rate_hz", "mode"), [(24.0, 11), (30.0, 6), (120.0, 1), (60.0, 6), (119.88, 18)])
def test_the_rate_is_that_of_the_keys_and_of_the_file(tmp_path: Path, rate_hz: float, mode: int) -> None:
    path = tmp_path / "a.fbx"
    path.write_bytes(dancing_fbx(mixamo(), dance(mixamo(), 40), rate_hz, TimeMode=[mode]).binary())
    body = read(path)
    assert body.rate_hz == pytest.approx(rate_hz)
    assert body.frames == 40


def test_keys_far_apart_are_joined_as_their_flags_have_it(tmp_path: Path) -> None:
    for flag in (2, 4, 8):
        scene = Builder()
        bones = scene.bones(mixamo())
        layer = scene.clip("dance", bones, mixamo(), dance(mixamo(), 25))
        times = np.array([0, TICKS // 2, TICKS])
        scene.curves(layer, bones["mixamorig:Hips"], "Lcl Translation", times, {"X": [0.0, 100.0, 0.0]}, flag)
        path = tmp_path / "a.fbx"
        path.write_bytes(scene.binary())
        # at 4/30 s, or 4/15 of the way to the second key
        share = 4 / 15
        at = {2: 0.0, 4: share, 8: 3 * share**2 - 2 * share**3}[flag]
        x = read(path).positions[JOINTS.index("root"), 0, 4]
        assert x == pytest.approx(at, abs=1e-6)


def test_a_model_without_motion_is_refused(tmp_path: Path) -> None:
    scene = Builder()
    scene.bones(mixamo())
    (tmp_path / "a.fbx").write_bytes(scene.binary())
    with pytest.raises(SourceError, match="holds no animation of a skeleton"):
        read(tmp_path / "a.fbx")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"hello", "is no FBX file"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + (6100).to_bytes(4, "little"), "is FBX of version 6100"),
        (b"; FBX\nFBXVersion: 6100\n", "is FBX of version 6100"),
        (b"; FBX\nFBXVersion: 7400\nObjects: {\n", r"a.fbx:\d+: the record Objects does not end"),
        (b"; FBX\nFBXVersion: 7400\n}\n", r"a.fbx:3: expected the name of a record"),
        (b"; FBX\nFBXVersion: 7400\nObjects: {\nPose: 1, {\nMatrix: *3 { a: 1,2 } } }", "must have 3 numbers, got 2"),
        (b"", "the file is empty"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.fbx").write_bytes(data)
    with pytest.raises(SourceError, match=message):
        read(tmp_path / "a.fbx")


def test_arrays_that_unpack_to_more_than_they_claim_are_refused(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 400))
    data = scene.binary(7400)
    at = data.index(b"KeyTime") + len(b"KeyTime")
    for count in (1, 10**9):
        changed = data[: at + 1] + count.to_bytes(4, "little") + data[at + 5 :]
        (tmp_path / "a.fbx").write_bytes(changed)
        with pytest.raises(SourceError, match=r"an array (must have 8 bytes|of 1000000000 numbers)"):
            read(tmp_path / "a.fbx")


def test_a_file_that_is_cut_anywhere_is_refused(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 3))
    for data in (scene.binary(7400), scene.binary(7500), scene.text()):
        for stop in (10, 26, 100, 1000, len(data) // 2, 9 * len(data) // 10):
            (tmp_path / "a.fbx").write_bytes(data[:stop])
            with pytest.raises(SourceError):
                read(tmp_path / "a.fbx")


def test_nodes_that_hang_from_themselves_are_refused(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 3))
    hips, spine = (
        next(part.values[0] for part in scene.objects.below if part.values[1][1] == f"mixamorig:{name}")
        for name in ("Hips", "Spine")
    )
    scene.links.below.insert(0, Part("C", ("OO", hips, spine)))
    (tmp_path / "a.fbx").write_bytes(scene.binary())
    with pytest.raises(SourceError, match="hangs from itself"):
        read(tmp_path / "a.fbx")


def test_memory_stays_below_its_bound(tmp_path: Path) -> None:
    scene = dancing_fbx(mixamo(), dance(mixamo(), 300))
    for data in (scene.binary(), scene.text()):
        path = tmp_path / "a.fbx"
        path.write_bytes(data)
        extent = reader_of(path).extent(MotionFile(path), len(JOINTS), ReadSettings())
        assert (extent.frames, extent.rate_hz) == (300, 30.0)
        read(path)
        tracemalloc.start()
        try:
            read(path)
            assert tracemalloc.get_traced_memory()[1] < extent.bytes
        finally:
            tracemalloc.stop()


@pytest.mark.shared
def test_models_of_others_rest_where_their_bvh_has_them(shared: Path) -> None:
    """GenoView's model at rest, and in its stance, as binary FBX 7.7 and as BVH."""
    folder = shared / "data" / "wild" / "GenoView"
    for name in ("Geno_bind", "Geno_stance"):
        scene = Scene(folder / f"{name}.fbx")
        (group,) = skeletons(scene)
        _, positions, _ = rest_of(scene, group)
        bvh = parse_bvh(folder / f"{name}.bvh")
        expected, _ = kinematics.forward(bvh.nodes, bvh.channels)
        named = {node.name: expected[i, :, 0] for i, node in enumerate(bvh.nodes)}
        for node, place in zip(group.nodes, positions, strict=True):
            np.testing.assert_allclose(place, named[scene.nodes[node].name], atol=0.001)  # cm


@pytest.mark.shared
def test_a_walk_of_others_is_that_of_its_bvh(shared: Path) -> None:
    """The walk of bvh-toolbox, with keys at 60 Hz, and as BVH at 24 Hz."""
    folder = shared / "data" / "wild" / "bvh-toolbox"
    scene = Scene(folder / "template.fbx")
    (clip,) = clips_of(scene)
    figure = figure_of(scene, clip)
    assert (figure.rate_hz, figure.frames) == (60.0, 251)
    bvh = parse_bvh(folder / "walk01.bvh")
    expected, _ = kinematics.forward(bvh.nodes, bvh.channels)
    positions, _ = figure.poses.at(np.arange(0, 251, 5), [])
    named = {node.name: 0.01 * expected[i, :, ::2] for i, node in enumerate(bvh.nodes)}
    for name, place in zip(figure.names, positions, strict=True):
        if name in named:
            np.testing.assert_allclose(place, named[name], atol=2e-4)
