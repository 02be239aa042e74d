"""OpenSim motions: models of versions 3 and 4, joints of every kind against truth by hand, units, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import multibody
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.opensim import OpenSimReader
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body
from tests.bodies import STANDING
from tests.osim_files import BODIES, KNOTS, MARKERS, TWIST, coordinates, model, motion

ORDER = load_feature_set().joints
AUTO = load_mappings("auto", ORDER)
RIGHT = {"hip_r": "rhip", "knee_r": "rknee", "ankle_r": "rankle", "mtp_r": "rtoes", "shoulder_r": "rshoulder"} | {
    "elbow_r": "relbow", "wrist_r": "rwrist", "head": "neck", "back": "belly", "Top": "headtop", "RFIN": "rfingers",
}  # fmt: skip


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def points(path: Path, model_path: Path | None = None) -> Points:
    return OpenSimReader().points(MotionFile(path), ReadSettings(body_model=model_path and str(model_path)))


def at(found: Points, name: str, frame: int = 0) -> np.ndarray:
    return found.positions[found.names.index(name), :, frame]


def refused(path: Path, *words: str, settings: ReadSettings = ReadSettings(), line: int | None = None) -> None:  # noqa: B008
    with pytest.raises(SourceError) as caught:
        read_body(path, None, AUTO, ORDER, settings)
    for word in words:
        assert word in str(caught.value)
    assert line is None or caught.value.line == line


def turn(axis: int, degrees: float) -> np.ndarray:
    angles = np.zeros(3)
    angles[axis] = np.deg2rad(degrees)
    return multibody.euler_xyz(angles)


@pytest.mark.parametrize("version", [3, 4])
def test_at_rest_joints_and_markers_are_where_the_model_has_them(tmp_path: Path, version: int) -> None:
    write(tmp_path / "walk.osim", model(version))
    found = points(write(tmp_path / "walk.mot", motion({"pelvis_ty": [1.0, 1.0], "hip_r_q0": [0.0, 0.0]})))
    for name, joint in RIGHT.items():
        np.testing.assert_allclose(at(found, name), STANDING[joint], atol=1e-12)
    assert (found.rate_hz, found.unit_m) == (100.0, 1.0)
    assert any("stay as in the model: pelvis_tilt" in warning for warning in found.warnings)


def test_a_person_at_rest_is_recognised(tmp_path: Path) -> None:
    write(tmp_path / "walk.osim", model())
    path = write(tmp_path / "walk.mot", motion({"pelvis_ty": [1.0] * 5, "pelvis_tx": [0.0, 0.01, 0.02, 0.03, 0.04]}))
    body = read_body(path, None, AUTO, ORDER)
    for joint in ("lhip", "rhip", "lknee", "rankle", "rtoes", "lshoulder", "relbow", "lwrist"):
        np.testing.assert_allclose(body.positions[ORDER.index(joint), :, 0], STANDING[joint], atol=1e-4)
    assert not body.unknown


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("degrees", ["yes", "no", ""])
def test_a_person_turns_and_bends_a_knee_as_worked_out_by_hand(tmp_path: Path, version: int, degrees: str) -> None:
    write(tmp_path / "walk.osim", model(version))
    unit = 1.0 if degrees != "no" else np.pi / 180
    values = {"pelvis_rotation": [0.0, 90.0 * unit], "pelvis_tx": [2.0, 3.0], "pelvis_ty": [1.0, 1.0]}
    values |= {"knee_r_angle": [90.0 * unit] * 2, "ankle_r_angle": [30.0 * unit] * 2}
    found = points(write(tmp_path / "walk.mot", motion(values, degrees=degrees)))
    hip, knee, ankle, toes = (np.array(STANDING[joint]) for joint in ("rhip", "rknee", "rankle", "rtoes"))
    there = np.array([2.0, 0.0, 0.0])
    # the knee's shift is a cubic polynomial of its angle; what lies below it turns about z, and then about the ankle
    bent = knee + np.array([0.01 * (np.pi / 2) ** 3, 0, 0])
    below = turn(2, 90)
    slant = multibody.euler_xyz(np.array(TWIST))
    foot = below @ slant @ turn(2, 30) @ slant.T
    low = bent + below @ (ankle - knee)
    expected = {"hip_r": hip, "knee_r": bent, "ankle_r": low, "mtp_r": low + foot @ (toes - ankle)}
    for name, place in expected.items():
        np.testing.assert_allclose(at(found, name), place + there, atol=1e-9)
        about = turn(1, 90) @ (place - STANDING["root"]) + STANDING["root"]
        np.testing.assert_allclose(at(found, name, 1), about + np.array([3, 0, 0]), atol=1e-9)
    if not degrees:
        assert any("does not state inDegrees" in warning for warning in found.warnings)


def test_axes_of_ball_universal_gimbal_and_planar_joints(tmp_path: Path) -> None:
    write(tmp_path / "walk.osim", model())
    values = {"pelvis_ty": [1.0] * 2, "hip_r_q0": [20.0] * 2, "hip_r_q1": [30.0] * 2, "hip_r_q2": [40.0] * 2}
    values |= {"back_q0": [10.0] * 2, "back_q2": [25.0] * 2, "neck_q0": [15.0] * 2, "neck_q1": [0.3] * 2}
    values |= {"radius_hand_r_q0": [35.0] * 2, "radius_hand_r_q1": [-20.0] * 2}
    found = points(write(tmp_path / "walk.mot", motion(values)))
    place = {joint: np.array(xyz) for joint, xyz in STANDING.items()}
    thigh = turn(0, 20) @ turn(1, 30) @ turn(2, 40)
    np.testing.assert_allclose(at(found, "knee_r"), place["rhip"] + thigh @ (place["rknee"] - place["rhip"]), atol=1e-9)
    trunk = turn(0, 10) @ turn(2, 25)
    neck = place["belly"] + trunk @ (place["neck"] - place["belly"] + [0.3, 0, 0])
    np.testing.assert_allclose(at(found, "head"), neck, atol=1e-9)
    top = neck + trunk @ turn(2, 15) @ (place["headtop"] - place["neck"])
    np.testing.assert_allclose(at(found, "Top"), top, atol=1e-9)
    wrist = place["belly"] + trunk @ (place["rwrist"] - place["belly"])
    hand = trunk @ turn(0, 35) @ turn(1, -20) @ (place["rfingers"] - place["rwrist"])
    np.testing.assert_allclose(at(found, "RFIN"), wrist + hand, atol=1e-9)


def test_coupled_coordinates_follow_unless_the_file_has_them(tmp_path: Path) -> None:
    write(tmp_path / "walk.osim", model())
    ankle = {"ankle_r_angle": [40.0, 40.0]}
    alone = points(write(tmp_path / "a.mot", motion(ankle)))
    same = points(write(tmp_path / "b.mot", motion(ankle | {"mtp_r_angle": [20.0, 20.0]})))
    other = points(write(tmp_path / "c.mot", motion(ankle | {"mtp_r_angle": [0.0, 0.0]})))
    np.testing.assert_allclose(alone.positions, same.positions, atol=1e-12)
    assert not any("mtp_r_angle" in warning for warning in alone.warnings)
    assert any("mtp_l_angle" in warning or "more" in warning for warning in other.warnings)


def test_states_tables_with_commas_and_uneven_times_are_read(tmp_path: Path) -> None:
    write(tmp_path / "walk.osim", model())
    values = {"pelvis_ty": [1.0, 1.1, 1.2, 1.3], "knee_r_angle": [0.0, 10.0, 20.0, 30.0]}
    plain = motion(values)
    expected = points(write(tmp_path / "a.mot", plain))
    states = points(write(tmp_path / "b.sto", motion(values, states=True)))
    np.testing.assert_allclose(states.positions, expected.positions, atol=1e-12)
    commas = points(write(tmp_path / "c.mot", plain.replace("\t", ",").replace("endheader", "endheader,,")))
    np.testing.assert_allclose(commas.positions, expected.positions, atol=1e-12)
    lines = plain.splitlines()
    uneven = [*lines[:9], lines[9].replace("0.01000", "0.00400").replace("1.1000000000", "1.0400000000"), *lines[10:]]
    shifted = points(write(tmp_path / "d.mot", "\n".join(uneven)))
    assert any("times are not even" in warning for warning in shifted.warnings)
    np.testing.assert_allclose(shifted.positions[0, 1], expected.positions[0, 1], atol=0.01)


def test_a_spline_is_that_of_its_outer_points_and_goes_on_straight() -> None:
    x, y = (np.array(axis) for axis in KNOTS)
    curve = multibody.spline(x, y)
    inside = np.linspace(0, 2, 41)
    np.testing.assert_allclose(curve(inside[None]), 0.01 * inside**3, atol=1e-12)
    np.testing.assert_allclose(curve(np.array([[-1.0, 3.0]])), [0.0, 0.08 + 0.12], atol=1e-12)
    np.testing.assert_allclose(multibody.spline(x[:2], y[1:3])(np.array([[0.25]])), [(y[1] + y[2]) / 2])
    np.testing.assert_allclose(multibody.spline(x[:3], x[:3] ** 2)(np.array([[0.3, 0.8]])), [0.09, 0.64], atol=1e-12)


def test_without_a_model_or_with_several_the_way_out_is_given(tmp_path: Path) -> None:
    path = write(tmp_path / "walk_01.mot", motion({"knee_r_angle": [0.0, 1.0]}))
    refused(path, "coordinates of an OpenSim model (knee_r_angle", "put its .osim file beside it", "--body-model")
    first, second = write(tmp_path / "ann.osim", model()), write(tmp_path / "bob.osim", model())
    refused(path, "several models", "ann.osim, bob.osim")
    write(tmp_path / "walk.osim", model())
    assert "the model walk.osim" in points(path).warnings[0]
    first.unlink()
    assert "the model bob.osim" in points(path, second).warnings[0]


def test_a_model_of_another_subject_is_not_taken_though_their_names_begin_alike(tmp_path: Path) -> None:
    path = write(tmp_path / "subject01_walk.mot", motion({"knee_r_angle": [0.0, 1.0]}))
    other = write(tmp_path / "subject02_walk.osim", model())
    refused(path, "of others", "subject02_walk.osim", "--body-model")
    assert "the model subject02_walk.osim" in points(path, other).warnings[0]
    write(tmp_path / "gait.osim", model())
    assert "the model gait.osim" in points(path).warnings[0]
    write(tmp_path / "Subject01.osim", model())
    assert "the model Subject01.osim" in points(path).warnings[0]
    write(tmp_path / "sub.osim", model())  # begins as the motion does, but is no whole word of it
    assert "the model Subject01.osim" in points(path).warnings[0]


def test_of_several_models_the_one_with_the_coordinates_of_the_motion_is_taken(tmp_path: Path) -> None:
    path = write(tmp_path / "walk_01.mot", motion({"knee_r_angle": [0.0, 1.0], "elbow_r_angle": [0.0, 1.0]}))
    write(tmp_path / "ann.osim", model())
    other = write(tmp_path / "bob.osim", model().replace("knee_r_angle", "right_knee"))
    assert "the model ann.osim" in points(path).warnings[0]  # bob.osim has one of both coordinates
    other.rename(tmp_path / "walk.osim")
    assert "the model walk.osim" in points(path).warnings[0]  # the name goes first
    write(tmp_path / "walk.osim", model().replace("knee_r_angle", "right_knee").replace("elbow_r_angle", "right_elbow"))
    assert "the model ann.osim" in points(path).warnings[0]  # unless that model has nothing of the motion
    write(tmp_path / "eve.osim", model())
    refused(path, "of which each has 2", "ann.osim, eve.osim", "--body-model")
    assert "the model eve.osim" in points(path, tmp_path / "eve.osim").warnings[0]


def test_forces_and_motions_of_other_models_are_no_motion(tmp_path: Path) -> None:
    forces = motion({"ground_force_vx": [1.0, 2.0], "ground_force_px": [0.0, 0.0], "ground_torque_x": [0.0, 1.0]})
    path = write(tmp_path / "grf.mot", forces)
    assert not is_motion_file(path)
    refused(path, "holds forces or activations", line=8)
    other = write(tmp_path / "pendulum.mot", motion({"r1_z": [0.0, 1.0]}))
    write(tmp_path / "walk.osim", model())
    refused(other, "has none of the coordinates of the model 'standing'", line=8)
    for text in ("", "PathFileType 4\n", "endheader\nx\ty\n", "DataType=Quaternion\nendheader\ntime\tpelvis_imu\n"):
        assert not is_motion_file(write(tmp_path / "x.sto", text))


def test_faults_of_motions_are_refused_with_their_line(tmp_path: Path) -> None:
    write(tmp_path / "walk.osim", model())
    text = motion({"knee_r_angle": [0.0, 1.0, 2.0], "pelvis_ty": [1.0, 1.0, 1.0]})
    path = tmp_path / "walk.mot"
    refused(write(path, text.replace("pelvis_ty", "knee_r_angle")), "two columns", line=8)
    refused(write(path, text.replace("2.0000000000", "nan")), "'knee_r_angle' has no number", "frame 2")
    refused(write(path, text.replace("2.0000000000", "x")), "not a number", line=11)
    refused(write(path, text.replace("0.0200000000", "0.0100000000")), "times ascend")
    refused(write(path, "\n".join(text.splitlines()[:8])), "no frames")
    refused(write(path, text.replace("endheader", "")), "ends with 'endheader'")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("<OpenSimDocument", "<!DOCTYPE a [<!ENTITY b 'c'>]><OpenSimDocument", ["document type declaration"]),
        ("</Model>", "", ["is not XML"]),
        ("Model", "Other", ["no OpenSim model"]),
        ("WeldJoint", "EllipsoidJoint", ["'subtalar_r'", "EllipsoidJoint, which is not read"]),
        ("SimmSpline", "GCVSpline", ["'knee_r'", "GCVSpline, which is not read"]),
        ("<x>0.0 0.5", "<x>0.0 0.0", ["knots that ascend"]),
        ("<axis>1 0 0", "<axis>0 0 0", ["axis without a direction"]),
        ("<coordinates>pelvis_tilt", "<coordinates>nobody", ["'nobody', which no joint before it has"]),
        ("/bodyset/femur_r</socket_parent>", "/bodyset/toes_r</socket_parent>", ["body 'toes_r'"]),
        ("<translation>0.0 ", "<translation>1e300 ", ["expected 3 numbers within 1e+06"]),
        ("</SpatialTransform>", "<a>" * 200 + "</a>" * 200 + "</SpatialTransform>", ["inside each other"]),
    ],
)
def test_models_that_are_not_read_are_refused_by_name(
    tmp_path: Path, before: str, after: str, words: list[str]
) -> None:
    text = model()
    assert before in text
    path = write(tmp_path / "walk.mot", motion({"knee_r_angle": [0.0, 1.0]}))
    write(tmp_path / "walk.osim", text.replace(before, after))
    refused(path, *words)


def test_the_model_of_the_tests_has_joints_of_every_kind() -> None:
    assert {kind for _, _, kind, _ in BODIES.values()} >= {"BallJoint", "PinJoint", "WeldJoint", "UniversalJoint"}
    assert len(coordinates()) == len(set(coordinates()))
    assert set(MARKERS) == {"Top", "RFIN", "LFIN"}


def test_motions_in_the_wild_ask_for_their_model(shared: Path) -> None:
    folder = shared / "data" / "wild"
    for name in ("opensim-core/subject01_walk_IK.mot", "pyomeca/inverse_kin.mot", "Pose2Sim_Blender/Moco_motion.mot"):
        assert is_motion_file(folder / name)
        refused(folder / name, "put its .osim file beside it")
    for name in ("opensim-core/subject01_walk_grf.mot", "Pose2Sim_Blender/Moco_forces.mot"):
        assert not is_motion_file(folder / name)
