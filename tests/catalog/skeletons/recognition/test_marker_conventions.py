"""Joints beneath markers by the conventions of marker sets: chords, hinges, and joint centres that a model computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings, load_skeleton
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.proposal import mapping_yaml
from kinedex.catalog.skeletons.skeleton_fit import Chord, Hinge, Mix
from kinedex.ops.errors import ConfigError
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.points import evidence_of
from studies.marker_accuracy import CENTRES, body_of, computed, distances_to_model, without
from tests.bodies import index

JOINTS = load_feature_set().joints
NUMBERS = st.floats(-2, 2)
PLACES = st.tuples(*[st.tuples(NUMBERS, NUMBERS, NUMBERS)] * 3).map(lambda rows: np.array(rows)[:, :, None])
PLUG_IN_GAIT = ["RoboStatic", "59993_Frame_Static", "Sample_Static"]


def at(mix: Mix, places: np.ndarray, hand: float = 1.0) -> np.ndarray:
    return mix.apply(dict(zip("abc", places, strict=True)), hand)[:, 0]


def is_flat(places: np.ndarray) -> bool:
    a, b, c = places[..., 0]
    return bool(np.linalg.norm(np.cross(b - a, c - a)) < 1e-2)


@given(PLACES, st.floats(0.05, 0.5))
def test_a_chord_ends_square_below_its_marker_in_the_plane_and_away_from_the_third(places, out) -> None:  # type: ignore[no-untyped-def]
    if is_flat(places):
        return
    a, b, c = places[..., 0]
    joint = at(Chord((("a", 1.0),), plane=("a", "b", "c"), out=out), places)
    assert np.linalg.norm(joint - a) == pytest.approx(out * np.linalg.norm(b - a))
    assert (joint - a) @ (joint - b) == pytest.approx(0, abs=1e-9)
    normal = np.cross(b - a, c - a)
    assert (joint - a) @ normal / np.linalg.norm(normal) == pytest.approx(0, abs=1e-9)
    assert np.cross(b - a, joint - a) @ normal < 0  # on the other side of the line from a to b than c is


@given(PLACES)
def test_a_hinge_moves_with_its_limb_and_is_the_same_in_a_mirror(places) -> None:  # type: ignore[no-untyped-def]
    hinge = Hinge((("a", 1.0),), plane=("a", "b", "c"), out=0.2)
    mirror = np.array([-1.0, 1.0, 1.0])[:, None]
    np.testing.assert_allclose(at(hinge, places * mirror, -1.0), at(hinge, places) * mirror[:, 0], atol=1e-9)
    whole = at(Mix((("a", 1.0),), plane=("a", "b", "c"), out=0.2), places)
    a, b, c = places[..., 0]
    lengths = np.linalg.norm(b - a) * np.linalg.norm(c - a)
    if lengths < 1e-9:  # Two places are one, and the limb has no bend.
        return
    share = np.clip((np.linalg.norm(np.cross(b - a, c - a)) / lengths - 0.1) / 0.1, 0, 1)
    np.testing.assert_allclose(at(hinge, places), a + share * (whole - a), atol=1e-9)


def test_a_corner_of_a_plane_may_be_a_combination_itself_and_stays_one_in_yaml(tmp_path: Path) -> None:
    corner = Mix((("b", 0.5), ("c", 0.5)))
    nested = Chord((("a", 1.0),), plane=("a", corner, "c"), out=0.2)
    assert nested.names == ("a", "b", "c")
    places = np.random.default_rng(0).normal(size=(3, 3, 4))
    plain = dict(zip("abc", places, strict=True)) | {"m": (places[1] + places[2]) / 2}
    same = Chord((("a", 1.0),), plane=("a", "m", "c"), out=0.2).apply(plain, 1.0)
    np.testing.assert_array_equal(nested.apply(plain, 1.0), same)


@pytest.mark.shared
def test_a_mapping_that_is_written_of_plug_in_gait_reads_the_same_body(shared: Path, tmp_path: Path) -> None:
    path = shared / "data" / "wild" / "pyCGM" / "Sample_Static.c3d"
    points = parse_c3d(path)
    markers = without(points, computed(points))
    fit = load_mappings("auto", JOINTS).detect(path, "c3d", markers.indices(), evidence_of(markers, "z"))
    own = tmp_path / "own.yaml"
    own.write_text(mapping_yaml(fit, "own"))
    read = load_skeleton(own, JOINTS).fit(markers.indices())
    np.testing.assert_allclose(
        read.apply(markers.positions, JOINTS), fit.apply(markers.positions, JOINTS), atol=2e-2
    )  # mm, as weights have six digits


@pytest.mark.parametrize(
    "aside",
    [
        "plane: [a, b, c], times: 1.5, kind: chord",
        "plane: [a, {virtual: {neck: 1}}, c], times: 0.1",
        "plane: [a, b, c], times: 1, kind: arc",
    ],
)
def test_a_plane_that_is_none_is_refused_with_its_joint(tmp_path: Path, aside: str) -> None:
    own = tmp_path / "own.yaml"
    joints = dict.fromkeys(JOINTS, "a") | {"lknee": f"{{nodes: {{a: 1}}, aside: {{{aside}}}}}"}
    lines = "\n".join(f"  {joint}: {made}" for joint, made in joints.items())
    own.write_text(f"name: own\nformat: c3d\nup: y\nfacing: z\nunit_m: 1\njoints:\n{lines}\n")
    with pytest.raises(ConfigError, match="lknee"):
        load_skeleton(own, JOINTS)


def test_sets_with_a_convention_of_their_own_are_told_by_their_labels() -> None:
    def sets(*labels: str) -> tuple[str, ...]:
        return load_landmarks().read([side + label for label in labels for side in "LR"]).sets

    legs, arms = ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE"), ("SHO", "ELB", "WRA", "WRB", "FIN")
    assert sets(*legs, *arms) == ("plug-in gait legs", "plug-in gait arms")
    assert sets(*legs) == ("plug-in gait legs",)
    assert sets("FWT", "BWT", "THI", "KNE", "SHN", "ANK", "HEE", "TOE", *arms) == ()  # CMU's
    assert sets("_IAS", "_IPS", "_FLE", "_FME", "_FAL", "_TAM", "_FCC", "_FM1") == ()


@pytest.mark.shared
@pytest.mark.parametrize("name", PLUG_IN_GAIT)
def test_joints_from_markers_alone_are_where_plug_in_gait_computes_them(shared: Path, name: str) -> None:
    path = shared / "data" / "wild" / "pyCGM" / f"{name}.c3d"
    found = distances_to_model(path, parse_c3d(path))[1]
    assert set(found) == set(CENTRES)
    for joint, away in found.items():
        assert away.mean() < (3.3 if joint.endswith("hip") else 2.4), joint


@pytest.mark.shared
@pytest.mark.parametrize("name", PLUG_IN_GAIT)
def test_joint_centres_of_a_model_are_the_joints_where_a_file_has_them(shared: Path, name: str) -> None:
    path = shared / "data" / "wild" / "pyCGM" / f"{name}.c3d"
    points = parse_c3d(path)
    body = body_of(path, points)
    for joint, label in CENTRES.items():
        centre = 0.001 * points.positions[points.indices()[label]]
        np.testing.assert_allclose(body.positions[index(joint)], centre, atol=1e-9)
