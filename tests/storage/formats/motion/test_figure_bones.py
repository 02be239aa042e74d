"""Mistakes in glTF and FBX skeletons are repaired, or a warning names them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import reader_of
from tests.bvh_files import POSITIONS, Joint, dance, mixamo
from tests.fbx_files import dancing_fbx
from tests.gltf_files import Builder, dancing_gltf

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)
Motion = list[dict[str, list[float]]]


def _glb(path: Path, root: Joint, motion: Motion) -> None:
    path.with_suffix(".glb").write_bytes(dancing_gltf(root, motion).glb())


def _fbx(path: Path, root: Joint, motion: Motion) -> None:
    path.with_suffix(".fbx").write_bytes(dancing_fbx(root, motion).binary())


WRITERS = [pytest.param(_glb, ".glb", id="glTF"), pytest.param(_fbx, ".fbx", id="FBX")]
Write = Callable[[Path, Joint, Motion], None]


def body_of(folder: Path, write: Write, ending: str, root: Joint, motion: Motion | None = None) -> Body:
    write(folder / "take", root, dance(root, 8) if motion is None else motion)
    path = folder / f"take{ending}"
    return reader_of(path).read(MotionFile(path), AUTO, JOINTS, ReadSettings())


def joint_of(root: Joint, name: str) -> Joint:
    return next(joint for joint in root.all() if joint.name.endswith(name))


def farthest(body: Body, right: Body) -> float:
    return float(np.nanmax(np.linalg.norm(body.positions - right.positions, axis=1)))


@pytest.mark.parametrize(("write", "ending"), WRITERS)
@pytest.mark.parametrize("bone", ["LeftLeg", "RightForeArm", "LeftShoulder", "RightFoot"])
def test_a_bone_without_length_has_that_of_the_other_side(tmp_path: Path, write: Write, ending: str, bone: str) -> None:
    right = body_of(tmp_path, write, ending, mixamo())
    root = mixamo()
    motion = dance(root, 8)
    joint_of(root, bone).offset = (0.0, 0.0, 0.0)
    body = body_of(tmp_path, write, ending, root, motion)
    assert farthest(body, right) < 0.01
    assert f"bone mixamorig:{bone} has no length in the file; the other side's is taken" in body.warnings


@pytest.mark.parametrize(("write", "ending"), WRITERS)
def test_a_neck_without_length_is_as_long_as_its_neighbours(tmp_path: Path, write: Write, ending: str) -> None:
    root = mixamo()
    joint_of(root, "Neck").offset = (0.0, 0.0, 0.0)
    body = body_of(tmp_path, write, ending, root)
    assert any("Neck has no length in the file; the mean of the bones beside is taken" in one for one in body.warnings)
    assert "neck" in body.estimated


@pytest.mark.parametrize(("write", "ending"), WRITERS)
@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_a_root_in_another_unit_moves_as_the_feet_stand(
    tmp_path: Path, write: Write, ending: str, factor: float
) -> None:
    root, motion = mixamo(), walk(mixamo(), 1.0)
    right = body_of(tmp_path, write, ending, root, motion)
    assert not right.warnings
    body = body_of(tmp_path, write, ending, root, walk(root, factor))
    assert farthest(body, right) < 0.01
    assert any("its root seems to move in another unit than that of the bones" in one for one in body.warnings)


def walk(root: Joint, unit: float) -> Motion:
    """Two legs that swing below hips which move ahead, so that one foot at a time stands on the floor."""
    motion = []
    for t in range(40):
        angle = 25.0 * np.sin(0.4 * t)
        step = 82.0 * abs(np.sin(np.deg2rad(angle)) - np.sin(np.deg2rad(25.0 * np.sin(0.4 * (t - 1)))))
        frame = {joint.name: [0.0] * len(joint.channels) for joint in root.all()}
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            leg = joint_of(root, f"{side}UpLeg")
            frame[leg.name][leg.channels.index("Xrotation")] = sign * angle
        before = motion[-1][root.name][2] / unit if motion else 0.0
        place = {"X": 0.0, "Y": 94.0, "Z": before + step}
        hips = frame[root.name]
        for i, channel in enumerate(root.channels):
            if channel in POSITIONS:
                hips[i] = unit * place[channel[0]]
        motion.append(frame)
    return motion


def test_a_skeleton_far_from_the_origin_keeps_its_short_bones(tmp_path: Path) -> None:
    """Bones are short by the other bones, and not by the way to a root that lies 100 m away."""
    root = mixamo()
    motion = dance(root, 8)
    for frame in motion:
        frame[root.name][0] += 10_000.0
    root.offset = (10_000.0, 100.0, 0.0)
    body = body_of(tmp_path, _glb, ".glb", root, motion)
    assert not body.warnings


def test_a_head_that_ends_in_a_node_without_a_known_name_is_doubted(tmp_path: Path) -> None:
    document = Builder()
    root = mixamo(prefix="", ends=False)
    places = document.nodes(root)
    document.json["skins"] = [{"joints": list(places.values())}]
    document.clip("dance", places, root, dance(root, 8))
    document.json["nodes"][places["Head"]]["name"] = "xq1"
    path = tmp_path / "take.glb"
    path.write_bytes(document.glb())
    body = reader_of(path).read(MotionFile(path), AUTO, JOINTS, ReadSettings())
    assert any("'xq1'" in warning for warning in body.warnings)
