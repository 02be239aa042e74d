"""Bodies among points: labels in all styles, regressions, hidden markers, T-poses, and what is no body."""

from __future__ import annotations

import contextlib
import warnings
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.point_centres import stand_ins
from kinedex.catalog.skeletons.recognition.points import recognise_points
from kinedex.ops.body import features
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import STANDING
from tests.c3d_files import LABELS, standing_markers

FEATURES = load_feature_set()
JOINTS = FEATURES.joints
LANDMARKS = load_landmarks()

SETS = {
    "Plug-in Gait": (
        "FHD BHD SHO ELB WRA WRB FIN ASI PSI THI KNE TIB ANK HEE TOE", "C7 T10 CLAV STRN RBAK", ()),
    "Plug-in Gait, one sacral marker": ("ASI THI KNE TIB ANK HEE TOE", "SACR", None),
    "CMU": ("FHD BHD SHO UPA ELB FRM WRA WRB FIN FWT BWT THI KNE SHN ANK HEE TOE MT5", "C7 T10 CLAV STRN", ()),
    "Helen Hayes": (
        ".ASIS .Thigh .Knee .Shank .Ankle .Heel .Toe .Shoulder .Elbow .Wrist", "V.Sacral Top.Head R.Offset", ()),
    "OptiTrack": (
        "ShoulderBack ShoulderTop ElbowOut UArmHigh HandOut WristOut WristIn Thigh KneeOut Shin AnkleOut ToeOut ToeIn",
        "HeadTop HeadFront HeadSide BackTop Chest WaistLFront WaistRFront WaistLBack WaistRBack", ()),
    "Qualisys CAST": (
        "_HDF _HDB _IAS _IPS _FTC _FLE _FME _FAL _TAM _FCC _FM1 _FM5 _SAJ _HLE _HME _RSP _UHE _HM2 _HM5",
        "SNJ SXS TV8 CV7", ()),
    "Rajagopal": (
        "ACR ASH PSH LEL MEL FAradius FAulna ASI PSI TH1 LFC MFC LMAL MMAL CAL TOE MT5", "C7 CLAV", ()),
    "HALPE-26": (
        "Hip Knee Ankle BigToe SmallToe Heel Shoulder Elbow Wrist", "Neck Head Nose", ()),
    "Vicon's 53": (
        "FHD BHD FSH BSH UPA ELB IEL FRM IWR OWR IHAND OHAND FWT BWT THI KNE KNI SHN ANK HEE MT5 MT1 TOE",
        "ARIEL C7 T10 CLAV STRN MFWT MBWT", ()),
}  # fmt: skip
"""Labels with a side, labels without one, and the unknown joints (None: all of the upper body)."""


def labels_of(name: str) -> list[str]:
    sided, middle, _ = SETS[name]
    return [side + label for label in sided.split() for side in "LR"] + middle.split()


@pytest.mark.parametrize("name", SETS)
def test_marker_sets_supply_the_joints_of_a_body(name: str) -> None:
    reading = LANDMARKS.read(labels_of(name))
    made = {joint for joint in JOINTS if LANDMARKS.mixes(joint, reading.labels)}
    legs = {f"{side}{part}" for side in "lr" for part in ("hip", "knee", "ankle", "toes")}
    arms = {f"{side}{part}" for side in "lr" for part in ("shoulder", "elbow", "wrist")}
    assert legs <= made
    assert arms <= made if SETS[name][2] is not None else not arms & made
    for joint in made:
        mixes = LANDMARKS.mixes(joint, reading.labels)
        assert all(abs(sum(weight for _, weight in mix.weights) - 1) < 1e-5 for mix in mixes), joint


OUTER = {f"{side}{joint}" for side in "lr" for joint in ("knee", "ankle", "elbow")}
"""Joints of which Plug-in Gait marks the outer side alone."""

LONG = {"L": "Left", "R": "Right"}

STYLES = {
    "glued": lambda side, label: side + label,
    "dotted": lambda side, label: f"{side}.{label}",
    "lower": lambda side, label: f"{side}_{label}".lower(),
    "words": lambda side, label: f"{LONG[side]} {label}",
    "at the end": lambda side, label: f"{label}_{side}",
    "long at the end": lambda side, label: f"{label}{LONG[side]}",
}


@given(
    style=st.sampled_from(sorted(STYLES)), prefix=st.sampled_from(["", "Ann:", "Ann_", "a:b:", "Skeleton 001_", "Zed"])
)
def test_labels_mean_the_same_in_every_style(style: str, prefix: str) -> None:
    sided = "ASI PSI THI KNE TIB ANK HEE TOE SHO ELB WRA WRB FIN FHD BHD".split()
    styled = {STYLES[style](side, label): side + label for label in sided for side in "LR"}
    middle = ["C7", "T10", "CLAV", "STRN"]
    plain = LANDMARKS.read([*styled.values(), *middle])
    found = LANDMARKS.read([prefix + label for label in (*styled, *middle)])
    back = {prefix + label: name for label, name in styled.items()} | {prefix + name: name for name in middle}
    assert {mark: tuple(back[label] for label in labels) for mark, labels in found.labels.items()} == plain.labels


def evidence(points: np.ndarray, names: tuple[str, ...] = LABELS, up: str | None = None) -> Evidence:
    return Evidence(names, points, up=up)


def test_joints_of_markers_lie_inside_of_the_body_and_the_neck_at_the_collar_bones() -> None:
    fit = recognise_points("x", evidence(standing_markers(8)), JOINTS)
    found = dict(zip(JOINTS, fit.apply(standing_markers(8), JOINTS)[:, :, 0], strict=True))
    assert (fit.unknown, fit.confidence, fit.rough, fit.doubts) == ((), 1.0, (), ())
    assert set(fit.estimated) == OUTER  # as the set has one marker there
    for joint, place in STANDING.items():
        np.testing.assert_allclose(found[joint], place, atol=0.16, err_msg=joint)
    clavicle, vertebra = 1.44, 1.51
    assert clavicle - 0.02 < found["neck"][1] < vertebra
    assert found["lhip"][1] < found["root"][1] < found["belly"][1] < found["chest"][1] < found["neck"][1]
    np.testing.assert_allclose(found["lhip"] * [-1, 1, 1], found["rhip"], atol=1e-9)
    assert any("30 of 30 labels name landmarks" in reason for reason in fit.reasons)


def test_a_lower_body_comes_in_with_unknown_joints_above() -> None:
    lower = tuple(label for label in LABELS if label[1:] in ("FWT", "BWT", "KNE", "ANK", "HEE", "TOE"))
    points = standing_markers(8)[[LABELS.index(label) for label in lower]]
    fit = recognise_points("x", evidence(points, lower), JOINTS)
    known = set(JOINTS) - set(fit.unknown)
    assert known == {"root", *(f"{side}{part}" for side in "lr" for part in ("hip", "knee", "ankle", "toes"))}


def test_an_upper_body_comes_in_without_a_root() -> None:
    upper = tuple(label for label in LABELS if label[1:] in ("SHO", "ELB", "WRA", "WRB", "FIN") or label[0] not in "LR")
    points = standing_markers(8)[[LABELS.index(label) for label in upper]]
    fit = recognise_points("x", evidence(points, upper), JOINTS)
    assert {"root", "lhip", "rknee"} <= set(fit.unknown)
    assert {"neck", "chest", "lshoulder", "relbow", "lwrist"} <= set(JOINTS) - set(fit.unknown)


ONE_ARM = {
    "ACRO_tip": "SHO", "EPICl": "ELB", "STYLr": "WRA", "STYLu": "WRB", "INDEX": "FIN",
}  # fmt: skip
"""Labels of a set for one arm, each with the marker where it lies."""


@pytest.mark.parametrize("side", ["l", "r"])
def test_the_arm_of_a_set_for_one_arm_is_that_of_the_nearer_side_of_the_pelvis(side: str) -> None:
    places = dict(zip(LABELS, standing_markers(4), strict=True))
    trunk = {"ASISl": "LFWT", "ASISr": "RFWT", "PSISl": "LBWT", "PSISr": "RBWT", "T1": "C7", "T10": "T10"}
    markers = trunk | {"XIPH": "STRN", "CLAV_SC": "CLAV", "CLAVl": "CLAV", "STER": "STRN"}
    markers |= {label: side.upper() + name for label, name in ONE_ARM.items()}
    evidence = Evidence(tuple(markers), np.array([places[name] for name in markers.values()]), up="y")
    fit = recognise_points("one.trc", evidence, JOINTS)
    other = "r" if side == "l" else "l"
    assert {f"{other}{part}" for part in ("shoulder", "elbow", "wrist", "fingers")} <= set(fit.unknown)
    assert not {f"{side}{part}" for part in ("shoulder", "elbow", "wrist", "fingers")} & set(fit.unknown)
    found = dict(zip(JOINTS, fit.apply(evidence.positions, JOINTS), strict=True))
    np.testing.assert_allclose(found[f"{side}elbow"], places[f"{side.upper()}ELB"], atol=1e-6)
    np.testing.assert_allclose(found[f"{side}shoulder"], places[f"{side.upper()}SHO"], atol=0.08)


def test_a_whole_limb_with_a_trunk_is_a_body_of_which_the_others_are_unknown() -> None:
    kept = [label for label in LABELS if label not in ("LELB", "RWRA", "RWRB", "RFIN", "LKNE", "LTOE", "LANK", "LHEE")]
    places = dict(zip(LABELS, standing_markers(4), strict=True))
    fit = recognise_points("a.trc", Evidence(tuple(kept), np.array([places[label] for label in kept])), JOINTS)
    assert {"lelbow", "rwrist", "lknee", "lankle"} <= set(fit.unknown)
    assert not {"rhip", "rknee", "rankle", "relbow", "neck", "root"} & set(fit.unknown)


def test_a_file_turned_on_its_side_is_turned_back_unless_it_states_what_is_up() -> None:
    points = standing_markers(8)
    lying = points[:, [2, 0, 1]]  # Z is up
    upright = recognise_points("x", evidence(points), JOINTS).apply(points, JOINTS)
    found = recognise_points("x", evidence(lying), JOINTS).apply(lying, JOINTS)
    np.testing.assert_allclose(found[:, 1], upright[:, 1], atol=1e-9)
    stated = recognise_points("x", evidence(lying, up="y"), JOINTS).apply(lying, JOINTS)
    np.testing.assert_array_equal(
        stated[:, 1], recognise_points("x", evidence(lying, up="y"), JOINTS).apply(lying, JOINTS)[:, 1]
    )
    assert not np.allclose(stated[:, 1], upright[:, 1])


@pytest.mark.parametrize(
    "names", [("Marker_1", "Marker_2", "Marker_3"), ("box:LASI", "box:top"), ("LKNE", "LANK", "C7")]
)
def test_what_is_no_body_is_refused_with_what_was_found(names: tuple[str, ...]) -> None:
    points = np.random.default_rng(0).normal(size=(len(names), 3, 8))
    with pytest.raises(SourceError, match=r"no human body is recognised .* labels are known.*kinedex mapping"):
        recognise_points("x", evidence(points, names), JOINTS)


def test_labels_of_a_body_on_points_of_none_are_refused() -> None:
    points = np.random.default_rng(0).normal(size=(len(LABELS), 3, 8))
    with pytest.raises(SourceError, match="no human proportions"):
        recognise_points("x", evidence(points), JOINTS)


@given(st.integers(0, len(LABELS) - 1), st.integers(0, 2), st.sampled_from([1e284, 1e308, -1e308]))
def test_numbers_that_nobody_measures_give_a_body_or_a_refusal(point: int, axis: int, number: float) -> None:
    points = standing_markers(3)
    points[point, axis] = number
    points[:, axis, 1] = -number
    with contextlib.suppress(SourceError), warnings.catch_warnings(action="error"):
        assert recognise_points("walk.trc", evidence(points), JOINTS).confidence <= 1


def test_stand_ins_place_a_joint_as_a_rigid_body_has_it() -> None:
    """The naive twin places the joint frame by frame, in the axes of three markers."""
    random = np.random.default_rng(1)
    frames = 20
    rotations = np.linalg.qr(random.normal(size=(frames, 3, 3)))[0]
    rotations *= np.sign(np.linalg.det(rotations))[:, None, None]
    body = random.normal(size=(5, 3))
    moved = np.einsum("kab,nb->nak", rotations, body) + random.normal(size=(1, 3, frames))
    labels = ("a", "b", "c", "d")
    places = dict(zip(labels, moved[:4].copy(), strict=True))
    places["a"][:, 3:6] = np.nan
    target = moved[4].copy()
    target[:, 5:] = np.nan
    mixes = stand_ins(places, target, labels, 1e-6)
    assert mixes
    for mix in mixes:
        place = mix.apply(places, 1.0)
        seen = np.isfinite(place).all(axis=0)
        np.testing.assert_allclose(place[:, seen], moved[4][:, seen], atol=1e-4)
        for k in np.flatnonzero(seen)[:3]:
            a, b, c = (body[labels.index(name)] for name in mix.plane)
            basis = np.stack([b - a, c - a, np.cross(b - a, c - a)], axis=1)
            local = np.linalg.solve(basis, body[4] - a)
            there = [places[name][:, k] for name in mix.plane]
            edges = np.stack([there[1] - there[0], there[2] - there[0]], axis=1)
            naive = there[0] + edges @ local[:2] + local[2] * np.cross(edges[:, 0], edges[:, 1])
            np.testing.assert_allclose(place[:, k], naive, atol=1e-4)
    assert {mix.plane for mix in mixes} <= set(combinations(labels, 3))


@pytest.mark.shared
@pytest.mark.parametrize("name", ["RoboStatic", "59993_Frame_Static", "Sample_Static"])
def test_hands_of_a_t_pose_are_not_above_the_neck(shared: Path, name: str) -> None:
    path = shared / "data" / "wild" / "pyCGM" / f"{name}.c3d"
    body = read_body(path, None, load_mappings("auto", JOINTS), JOINTS)
    assert (body.unknown, body.estimated, body.valid) == ((), (), None)  # the model's joints are there
    words = features.words(body.positions, body.orientation, body.rate_hz, FEATURES.rules)
    assert not (words & np.uint64(0b1100)).any()
