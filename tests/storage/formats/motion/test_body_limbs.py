"""Turns and markers of limbs, read from motion files at their own rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.limbs import LIMB_NAMES, LIMBS
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings, load_skeleton
from kinedex.ops.errors import ConfigError, SourceError
from kinedex.ops.inertial.limb_orientation import segment_orientation, unit_direction
from kinedex.ops.inertial.rotations import conjugate, distance_deg, multiply, rotate
from kinedex.storage.formats.motion.body_limbs import BodyLimbs, read_body_limbs
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from tests.bvh_files import bvh_text, dance, mixamo
from tests.c3d_files import standing_markers, write_c3d
from tests.gltf_files import dancing_gltf
from tests.storage.formats.motion.test_amass import SMPLH, angles, parents, rest, save

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)
RIGID = ("lupperarm", "rforearm", "lthigh", "rshank")
"""Limbs whose far joint hangs from the very node that turns with them."""


def read(path: Path, skeleton: Path | None = None, mappings: Mappings = AUTO, **settings: str) -> BodyLimbs:
    return read_body_limbs(MotionFile(path, skeleton), mappings, JOINTS, ReadSettings(**settings), LIMB_NAMES)


def axes_of(found: BodyLimbs, limb: str) -> np.ndarray:
    """The long axis in the segment's frame, in each frame."""
    near, far = (found.body.positions[JOINTS.index(joint)].T for joint in (LIMBS[limb].near, LIMBS[limb].far))
    return rotate(conjugate(found.rotations[limb]), unit_direction(near, far))


def since_first(q: np.ndarray) -> np.ndarray:
    return multiply(q, conjugate(q[0]))


def dancing_bvh(folder: Path, frames: int = 12) -> Path:
    path = folder / "dance.bvh"
    path.write_text(bvh_text(mixamo(), dance(mixamo(), frames)))
    return path


def test_limbs_of_bvh_turn_with_their_nodes(tmp_path: Path) -> None:
    found = read(dancing_bvh(tmp_path))
    assert set(found.rotations) == set(LIMB_NAMES)
    for limb in RIGID:
        axes = axes_of(found, limb)
        np.testing.assert_allclose(axes, axes[:1].repeat(12, axis=0), atol=1e-6)


def test_limbs_of_gltf_turn_as_those_of_bvh(tmp_path: Path) -> None:
    bvh = read(dancing_bvh(tmp_path))
    path = tmp_path / "dance.glb"
    path.write_bytes(dancing_gltf(mixamo(), dance(mixamo(), 12)).glb())
    gltf = read(path)
    for limb in LIMB_NAMES:
        assert distance_deg(since_first(gltf.rotations[limb]), since_first(bvh.rotations[limb])).max() < 1e-3


def test_limbs_of_amass_turn_with_their_joints(tmp_path: Path) -> None:
    np.savez(tmp_path / "model.npz", joints=rest(), names=np.array(SMPLH), parents=np.array(parents()))
    found = read(save(tmp_path / "a.npz", angles(9)), body_model=str(tmp_path / "model.npz"))
    for limb in RIGID:
        axes = axes_of(found, limb)
        np.testing.assert_allclose(axes, axes[:1].repeat(9, axis=0), atol=1e-9)


def test_markers_of_limbs_are_found_by_their_landmarks(tmp_path: Path) -> None:
    walk = 1000.0 * standing_markers(20)
    found = read(write_c3d(tmp_path / "walk.c3d", walk))
    assert {"torso", "head", "pelvis"} <= set(found.markers)
    assert not found.rotations
    fit = segment_orientation(found.markers["torso"])
    assert distance_deg(fit.orientation, fit.orientation[0]).max() < 1e-6
    assert found.markers["torso"][0].mean(axis=0)[1] == pytest.approx(1.4, abs=0.1)


def own_mapping(folder: Path, name: str, limbs: str) -> Mappings:
    text = load_skeleton(name, JOINTS).path.read_text()
    (folder / "own.yaml").write_text(text.replace("\njoints:\n", f"\nlimbs:\n  {limbs}\njoints:\n"))
    return load_mappings(folder / "own.yaml", JOINTS)


def test_a_mapping_names_the_node_and_the_axis_of_a_limb(tmp_path: Path) -> None:
    path = dancing_bvh(tmp_path)
    own = own_mapping(tmp_path, "mixamo", "torso: {node: Spine, axis: [root, neck]}")
    found = read(path, mappings=own)
    assert found.ends == {"torso": ("root", "neck")}
    assert distance_deg(found.rotations["torso"], read(path).rotations["torso"]).max() > 5.0
    assert own.of_format["bvh"][0].digest == load_skeleton("mixamo", JOINTS).digest, "takes do not depend on limbs"
    with pytest.raises(SourceError, match=r"no 'Spinal', which mapping 'mixamo' .* takes for limb 'torso'; did you"):
        read(path, mappings=own_mapping(tmp_path, "mixamo", "torso: {node: Spinal}"))


def test_a_mapping_names_the_markers_of_a_limb(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "walk.c3d", 1000.0 * standing_markers(20), only="")
    text = load_skeleton("hdm05-c3d", JOINTS).path.read_text().replace("\nonly:", "\n#only:")
    (tmp_path / "own.yaml").write_text(
        text.replace("\njoints:\n", "\nlimbs:\n  lfoot: {markers: [LHEE, LTOE, LANK]}\njoints:\n")
    )
    found = read(path, mappings=load_mappings(tmp_path / "own.yaml", JOINTS))
    assert found.markers["lfoot"].shape == (20, 3, 3)
    (tmp_path / "own.yaml").write_text(
        text.replace("\njoints:\n", "\nlimbs:\n  lfoot: {markers: [LHEE, LTOE, LAMK]}\njoints:\n")
    )
    with pytest.raises(SourceError, match=r"no marker 'LAMK', .* on limb 'lfoot'; did you mean 'LANK'"):
        read(path, mappings=load_mappings(tmp_path / "own.yaml", JOINTS))


@pytest.mark.parametrize(
    ("limbs", "message"),
    [
        ("lshanks: {node: Spine}", "no limb of that name; did you mean 'lshank'"),
        ("lshank: {markers: [a, b, c]}", "format bvh has no markers; give `node`"),
        ("lshank: {node: a, markers: [a, b, c]}", "`node` or `markers`, not both"),
        ("lshank: {}", "expected `node`"),
        ("lshank: {axis: [lknee, lanke]}", "no joint is named 'lanke'; did you mean 'lankle'"),
        ("lshank: {axis: [lknee, lknee]}", "between two joints"),
        ("lshank: {node: a, axiss: [lknee, lankle]}", "axis"),
    ],
)
def test_wrong_limbs_of_a_mapping_are_named(tmp_path: Path, limbs: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as fault:
        own_mapping(tmp_path, "mixamo", limbs)
    assert fault.value.line is not None


def test_points_do_not_turn(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="points of format c3d do not turn; give `markers`"):
        own_mapping(tmp_path, "hdm05-c3d", "lfoot: {node: LHEE}")
    with pytest.raises(ConfigError, match="'LHEE' is listed twice"):
        own_mapping(tmp_path, "hdm05-c3d", "lfoot: {markers: [LHEE, LTOE, LHEE]}")


@pytest.mark.shared
def test_limbs_of_acclaim_turn_as_those_of_the_same_take_as_bvh(shared: Path) -> None:
    folder = shared / "data/cmu/same_take_amc_and_bvh"
    acclaim, bvh = read(folder / "01_01.amc", folder / "01.asf"), read(folder / "01_01.bvh")
    assert set(acclaim.rotations) == set(LIMB_NAMES)
    for limb in set(LIMB_NAMES) - {"torso"}:  # the two have other nodes in the spine
        first, second = since_first(acclaim.rotations[limb]), since_first(bvh.rotations[limb][1:])
        assert distance_deg(first, second).max() < 0.2, limb
    for limb in RIGID:
        axes = axes_of(acclaim, limb)
        np.testing.assert_allclose(axes, axes[:1].repeat(len(axes), axis=0), atol=1e-6)
