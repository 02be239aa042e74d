"""AMASS files: joint angles old and new, the body models that they need, and the message where one is missing."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import axisangle, kinematics
from kinedex.ops.errors import ConfigError, SourceError
from kinedex.storage.formats.motion.amass import parse_amass
from kinedex.storage.formats.motion.body_models import BODY, FACE, HANDS, load_body_model
from kinedex.storage.formats.motion.reader import Body, ReadSettings
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from tests.bodies import STANDING
from tests.oracles import axisangle as oracle
from tests.point_files import keypoints_of

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)
MAPPING = AUTO.of_format["amass"][0]
SMPLH = (*BODY, *HANDS)

COCO_17 = load_keypoint_set("coco-17").order


def rest(names: tuple[str, ...] = SMPLH) -> np.ndarray:
    """Joints at rest (J, 3): the standing figure, with fingers that go on from the wrists."""
    placed = {mix.node: STANDING[joint] for joint, mixes in MAPPING.joints.items() if (mix := mixes[0]) and mix.node}
    positions = []
    for name in names:
        side = name.split("_")[0]
        if name in placed:
            positions.append(placed[name])
        elif name in HANDS or name.endswith("_hand"):
            wrist, step = np.array(placed[f"{side}_wrist"]), (int(name[-1]) if name[-1].isdigit() else 1)
            apart = 0.01 * HANDS.index(name) if name in HANDS else 0.0
            positions.append(wrist + np.array([apart, -0.05 * step, 0.0]))
        else:
            positions.append({"spine3": (0, 1.35, 0)}.get(name, (0, 1.6, 0.05)))
    return np.array(positions, float)


def parents(names: tuple[str, ...] = SMPLH) -> list[int]:
    above = dict(zip(BODY, (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19), strict=True))
    found = []
    for i, name in enumerate(names):
        if name in above:
            found.append(above[name])
        elif name in FACE:
            found.append(names.index("head"))
        else:
            side = names.index(f"{name.split('_')[0]}_wrist")
            found.append(side if name.endswith(("_hand", "1")) else i - 1)
    return found


def angles(frames: int, joints: int = 52, seed: int = 0) -> dict[str, Any]:
    """The arrays of an AMASS file: a figure that stands in axes with Z up and moves about a little."""
    random = np.random.default_rng(seed)
    rotations = random.normal(0, 0.2, (frames, joints, 3))
    rotations[:, 0] = [np.pi / 2, 0, 0]
    return {
        "poses": rotations.reshape(frames, -1), "trans": random.normal(0, 0.1, (frames, 3)), "betas": np.zeros(16),
        "gender": np.array("female"), "mocap_framerate": np.array(120.0),
    }  # fmt: skip


def save(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path


def table(path: Path, names: tuple[str, ...] = SMPLH) -> str:
    """A body model as a table of joints."""
    lines = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(names, rest(names).tolist(), strict=True)]
    path.write_text("joint,x,y,z\n" + "\n".join(lines) + "\n")
    return str(path)


def read(path: Path, model: str | None, **given: Any) -> Body:
    return read_body(path, None, AUTO, JOINTS, ReadSettings(body_model=model, **given))


def joint(body: Body, name: str) -> np.ndarray:
    return body.positions[JOINTS.index(name)]


def test_joints_are_where_the_angles_bring_those_of_the_model(tmp_path: Path) -> None:
    arrays = angles(5)
    body = read(save(tmp_path / "a.npz", arrays), table(tmp_path / "model.csv"))
    assert (body.skeleton, body.rate_hz, body.unit, body.unknown) == ("smpl-amass", 120.0, "1 m", ())
    for t in range(5):
        expected = oracle.pose(rest(), parents(), arrays["poses"][t].reshape(-1, 3), arrays["trans"][t])
        for name, node in {
            "lwrist": "left_wrist",
            "rtoes": "right_foot",
            "chest": "spine2",
            "lfingers": "left_middle1",
        }.items():
            x, y, z = expected[SMPLH.index(node)]
            np.testing.assert_allclose(joint(body, name)[:, t], [x, z, -y], atol=1e-12)
    np.testing.assert_allclose(np.abs(body.orientation[0]), 1.0, atol=1e-9)  # it stands as at rest, and faces +Z


def test_a_figure_that_stands_at_rest_stands_in_the_store(tmp_path: Path) -> None:
    arrays = angles(2) | {"poses": np.tile([np.pi / 2, *np.zeros(155)], (2, 1)), "trans": np.zeros((2, 3))}
    body = read(save(tmp_path / "a.npz", arrays), table(tmp_path / "model.csv"))
    for name in ("lknee", "rwrist", "head", "rtoes"):
        # The pelvis stays where it is at rest, and the body turns about it.
        x, y, z = np.array(STANDING[name]) - STANDING["root"]
        np.testing.assert_allclose(joint(body, name)[:, 0] - joint(body, "root")[:, 0], [x, y, z], atol=1e-12)


def test_newer_files_hold_the_same_in_parts_and_name_their_rate_otherwise(tmp_path: Path) -> None:
    model = table(tmp_path / "model.csv")
    old = angles(4)
    poses = old["poses"]
    new = {key: old[key] for key in ("trans", "betas")} | {"gender": np.array(b"female"), "mocap_frame_rate": 60}
    new |= {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "pose_hand": poses[:, 66:]}
    parts = read(save(tmp_path / "b.npz", new), model)
    np.testing.assert_array_equal(parts.positions, read(save(tmp_path / "a.npz", old), model).positions)
    assert parts.rate_hz == 60.0
    del new["pose_hand"]
    still = read(save(tmp_path / "c.npz", new), model)
    np.testing.assert_array_equal(joint(still, "lwrist"), joint(parts, "lwrist"))


def test_angles_and_models_of_other_bodies_go_together_by_name(tmp_path: Path) -> None:
    smplx = (*BODY, *FACE, *HANDS)
    whole = read(save(tmp_path / "a.npz", angles(3)), table(tmp_path / "h.csv"))
    wide = angles(3)
    rotations = wide["poses"].reshape(3, 52, 3)
    wide["poses"] = np.concatenate([rotations[:, :22], np.zeros((3, 3, 3)), rotations[:, 22:]], axis=1).reshape(3, -1)
    np.testing.assert_allclose(
        read(save(tmp_path / "b.npz", wide), table(tmp_path / "x.csv", smplx)).positions, whole.positions, atol=1e-12
    )
    bare = read(tmp_path / "a.npz", table(tmp_path / "body.csv", BODY))
    np.testing.assert_allclose(joint(bare, "rwrist"), joint(whole, "rwrist"), atol=1e-12)
    assert any("lfingers (-0.25 lelbow +1.25 lwrist)" in line for line in bare.evidence)
    smpl = read(tmp_path / "a.npz", table(tmp_path / "s.csv", (*BODY, "left_hand", "right_hand")))
    assert np.isfinite(joint(smpl, "lfingers")).all()


def test_a_model_comes_as_a_table_as_yaml_as_arrays_or_as_it_is_published(tmp_path: Path) -> None:
    expected = load_body_model(table(tmp_path / "a.csv"), "male")
    yaml = {"joints": dict(zip(SMPLH, rest().tolist(), strict=True))}
    (tmp_path / "b.yaml").write_text(json.dumps(yaml))
    save(tmp_path / "c.npz", {"joints": rest()})
    save(tmp_path / "d.npz", {"joints": rest()[::-1], "names": np.array(SMPLH[::-1])})
    random = np.random.default_rng(0)
    skin = random.normal(size=(200, 3))
    regressor = rest() @ np.linalg.pinv(skin)
    moved = random.normal(size=(200, 3, 20))
    published = {"v_template": skin, "J_regressor": regressor, "shapedirs": moved, "posedirs": np.zeros((1, 1))}
    save(tmp_path / "e.npz", published)
    for name in ("b.yaml", "c.npz", "d.npz", "e.npz"):
        model = load_body_model(str(tmp_path / name), "male")
        assert (model.names, model.parents) == (expected.names, expected.parents)
        np.testing.assert_allclose(model.joints, rest(), atol=1e-9)
    assert expected.parents == tuple(parents())
    shape = random.normal(size=16)
    np.testing.assert_allclose(
        model.rest(shape), rest() + np.einsum("jv,vab,b->ja", regressor, moved[:, :, :16], shape), atol=1e-9
    )


def test_a_figure_s_shape_counts_where_the_model_has_shapes_and_is_said_where_not(tmp_path: Path) -> None:
    shapes = np.zeros((52, 3, 2))
    shapes[SMPLH.index("left_wrist"), 0, 1] = 0.5
    save(tmp_path / "model.npz", {"joints": rest(), "shapes": shapes})
    arrays = angles(2) | {"poses": np.zeros((2, 156)), "betas": np.array([0.0, 0.1, 3.0])}
    path = save(tmp_path / "a.npz", arrays)
    shaped, plain = read(path, str(tmp_path / "model.npz")), read(path, table(tmp_path / "model.csv"))
    np.testing.assert_allclose(joint(shaped, "lwrist")[0] - joint(plain, "lwrist")[0], 0.05)
    assert plain.warnings[0] == "the figure has the shape of the body model; that of the file (betas) is not used"
    assert not any("betas" in warning for warning in shaped.warnings)


def test_a_model_may_depend_on_the_figure_s_gender(tmp_path: Path) -> None:
    (tmp_path / "female").mkdir()
    table(tmp_path / "female" / "model.csv")
    path = save(tmp_path / "a.npz", angles(2))
    assert read(path, str(tmp_path / "{gender}" / "model.csv")).frames == 2
    male = save(tmp_path / "b.npz", angles(2) | {"gender": np.array("male")})
    with pytest.raises(SourceError, match=r"male/model.csv: no such body model"):
        read(male, str(tmp_path / "{gender}" / "model.csv"))
    escaping = save(tmp_path / "c.npz", angles(2) | {"gender": np.array("../female")})
    with pytest.raises(SourceError, match=r"must be male, female or neutral, got '[.][.]/female'"):
        read(escaping, str(tmp_path / "{gender}" / "model.csv"))


def test_without_a_body_model_the_error_says_what_to_give(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", angles(2))
    with pytest.raises(
        SourceError, match=r"joint angles of a body \(AMASS, SMPL\).*give `body_model`, your model.npz of SMPL-H"
    ):
        read(path, None)


def test_angles_are_told_from_positions(tmp_path: Path) -> None:
    assert reader_of(save(tmp_path / "a.npz", angles(2))).format == "amass"
    assert reader_of(save(tmp_path / "b.npz", {"positions": np.zeros((2, 24, 3))})).format == "positions"
    assert reader_of(save(tmp_path / "c.npz", angles(2) | {"joints": np.zeros((2, 24, 3))})).format == "positions"
    (tmp_path / "d.npz").write_bytes(b"PK nonsense")
    assert reader_of(tmp_path / "d.npz").format == "positions"


GOOD = angles(3)
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "no trans": ({"trans": None}, "has no `trans`"),
    "frames that differ": ({"trans": np.zeros((2, 3))}, "`trans` must have 3 frames of 3 numbers"),
    "angles of no body": ({"poses": np.zeros((3, 99))}, "`poses` must have 66, 72, 156, 165 angles a frame, got 99"),
    "angles of one dimension": ({"poses": np.zeros(156)}, "`poses` must be angles of frames"),
    "no frames": ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "`poses` must be angles"),
    "no number": ({"poses": np.full((3, 156), np.nan)}, "`poses` has numbers that are NaN"),
    "infinity": ({"trans": np.full((3, 3), np.inf)}, "`trans` has numbers that are NaN, infinite"),
    "text": ({"betas": np.array(["thin"])}, "`betas` must be numbers"),
    "a rate of zero": ({"mocap_framerate": np.array(0.0)}, "the rate must be one number"),
    "no rate": (
        {"mocap_framerate": None},
        "has none of mocap_framerate, mocap_frame_rate, fps, frame_rate: give `rate_hz`, or --rate",
    ),
    "far away": ({"trans": np.full((3, 3), 1e9)}, "joint 'root' is more than 100 km away"),
    "an object": ({"gender": np.array([{}])}, "'gender' holds Python objects"),
    "parts without a root": ({"poses": None, "pose_body": np.zeros((3, 63))}, "has no `root_orient`, nor `poses`"),
    "parts of other lengths": (
        {"poses": None, "root_orient": np.zeros((3, 3)), "pose_body": np.zeros((2, 63))}, "`pose_body` must have 63",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, fault: str) -> None:
    changes, message = FAULTS[fault]
    arrays = {key: array for key, array in (GOOD | changes).items() if array is not None}
    path = save(tmp_path / "a.npz", arrays)
    with pytest.raises(SourceError, match=message):
        read(path, table(tmp_path / "model.csv"))
    if fault == "no rate":
        assert read(path, str(tmp_path / "model.csv"), rate_hz=50.0).rate_hz == 50.0


MODELS: dict[str, tuple[str, Any, str]] = {
    "no such ending": ("m.pkl", b"", "is an .npz, .csv or .yaml file"),
    "a joint missing": ("m.csv", b"joint,x,y,z\npelvis,0,0,0\n", "lacks the joint 'left_hip'"),
    "no numbers": ("m.csv", b"joint,x,y,z\npelvis,0,here,0\n", r"m.csv:2: expected columns joint, x, y, z"),
    "other columns": ("m.csv", b"name,x\npelvis,0\n", r"m.csv:2: expected columns"),
    "YAML of something else": ("m.yaml", b"joints: 3\n", "expected `joints: "),
    "two numbers": ("m.yaml", b"joints: {pelvis: [1, 2]}\n", "expected three numbers of metres"),
    "another count": ("m.npz", {"joints": np.zeros((30, 3))}, "has 30 joints without `names`"),
    "no joints": ("m.npz", {"J_regresor": np.zeros((30, 3))}, "must have `joints`, or `v_template` and `J_regressor`"),
    "another skin": ("m.npz", {"v_template": np.zeros((9, 3)), "J_regressor": np.zeros((52, 8))}, "go together"),
    "huge": ("m.csv", b"joint,x,y,z\n" + b"".join(b"%s,1e300,0,0\n" % n.encode() for n in BODY), "or beyond 1e\\+09"),
    "NaN": ("m.npz", {"joints": np.full((52, 3), np.nan)}, "`joints` has numbers that are NaN"),
}  # fmt: skip


@pytest.mark.parametrize("fault", MODELS)
def test_what_is_wrong_with_a_model_is_said(tmp_path: Path, fault: str) -> None:
    name, content, message = MODELS[fault]
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        save(tmp_path / name, content)
    with pytest.raises((SourceError, ConfigError), match=message):
        load_body_model(str(tmp_path / name), "neutral")


def test_angles_are_read_as_they_are_written(tmp_path: Path) -> None:
    poses = parse_amass(save(tmp_path / "a.npz", GOOD))
    assert (poses.names, poses.gender, poses.rotations.shape) == (SMPLH, "female", (3, 52, 3))


def pickled(path: Path, arrays: dict[str, Any]) -> Path:
    path.write_bytes(pickle.dumps(arrays, protocol=2))
    return path


def upright_angles(frames: int = 5) -> dict[str, Any]:
    """Angles of a body that stands along Y, as estimators and AIST++ have it."""
    arrays = angles(frames, 24)
    rotations = arrays["poses"].reshape(frames, -1, 3)
    rotations[:, 0] = 0.0
    positions = np.zeros((frames, 3))
    positions[:, 2] = 0.1 * np.arange(frames)
    return {"poses": rotations.reshape(frames, -1), "trans": positions}


def test_pickles_of_mosh_hold_the_same_motion_under_names_of_their_own(tmp_path: Path) -> None:
    model = table(tmp_path / "model.csv", (*BODY, "left_hand", "right_hand"))
    arrays = upright_angles()
    poses, trans = arrays["poses"], arrays["trans"]
    expected = read(pickled(tmp_path / "a.pkl", arrays | {"fps": 120.0, "smpl_trans": trans, "fullpose": poses}), model)
    details = {"markers_obs": [trans], "mocap_frame_rate": 120.0, "cfg": {"surface_model": {"gender": "female"}}}
    new = {"fullpose": poses, "trans": trans, "stageii_debug_details": details, "betas": np.zeros(300)}
    new |= {"markers_latent": np.zeros((9, 3)), "latent_labels": ["LKNE"] * 9}
    old = {"pose_est_fullposes": poses, "pose_est_trans": trans, "shape_est_betas": np.zeros(10)}
    for name, content in (("b", new), ("c", old | {"mocap_framerate": 120.0})):
        path = pickled(tmp_path / f"{name}.pkl", content)
        assert is_motion_file(path)
        body = read(path, model)
        np.testing.assert_array_equal(body.positions, expected.positions)
        assert body.rate_hz == 120.0
    assert parse_amass(tmp_path / "b.pkl").gender == "female"


def test_aist_is_in_centimetres_at_60_hz_and_stands_along_y(tmp_path: Path) -> None:
    model = table(tmp_path / "model.csv", (*BODY, "left_hand", "right_hand"))
    arrays = upright_angles()
    aist = {"smpl_loss": 1.5, "smpl_poses": arrays["poses"], "smpl_scaling": np.array([93.0])}
    path = pickled(tmp_path / "a.pkl", aist | {"smpl_trans": 93.0 * arrays["trans"]})
    assert is_motion_file(path)
    body = read(path, model)
    assert (body.rate_hz, body.unit) == (60.0, "1 m")
    assert any("up is y by posture" in reason for reason in body.evidence)
    names = (*BODY, "left_hand", "right_hand")
    for t in range(5):
        expected = oracle.pose(rest(names), parents(names), arrays["poses"][t].reshape(-1, 3), arrays["trans"][t])
        np.testing.assert_allclose(joint(body, "rwrist")[:, t], expected[names.index("right_wrist")], atol=1e-9)


def test_angles_of_estimators_come_in_parts_as_matrices_and_nested(tmp_path: Path) -> None:
    model = table(tmp_path / "model.csv", (*BODY, "left_hand", "right_hand"))
    arrays = upright_angles()
    rotations = arrays["poses"].reshape(5, 24, 3)
    whole = read(
        save(tmp_path / "a.npz", {"fps": 30, "smpl_poses": arrays["poses"], "smpl_trans": arrays["trans"]}), model
    )
    parts = {
        "global_orient": rotations[:, 0],
        "body_pose": rotations[:, 1:],
        "transl": arrays["trans"],
        "betas": np.zeros((5, 10)),
    }
    matrices = {
        "global_orient": axisangle.matrices(rotations[:, 0]).reshape(5, 1, 3, 3),
        "body_pose": axisangle.matrices(rotations[:, 1:].reshape(-1, 3)).reshape(5, 23, 3, 3),
        "transl": arrays["trans"],
    }
    for path in (
        save(tmp_path / "b.npz", parts | {"fps": 30}),
        pickled(tmp_path / "c.pkl", {"smpl_params_global": matrices | {"fps": 30.0}}),
        pickled(tmp_path / "d.pkl", parts | {"mocap_frame_rate": 30.0}),
    ):
        assert is_motion_file(path)
        body = read(path, model)
        assert body.rate_hz == 30.0
        if path.suffix == ".pkl" and path.stem == "d":
            continue  # the rate's key is that of AMASS, whose files have Z up
        np.testing.assert_allclose(body.positions, whole.positions, atol=1e-9)


def test_pickles_of_body_models_and_of_other_things_are_no_takes(tmp_path: Path) -> None:
    for name, content in {
        "model": {"J_regressor": np.zeros((2, 2)), "poses": np.zeros(3), "v_template": np.zeros((2, 3))},
        "other": {"weights": np.zeros(5)},
        "list": [1, 2, 3],
    }.items():
        (tmp_path / f"{name}.pkl").write_bytes(pickle.dumps(content))
        assert not is_motion_file(tmp_path / f"{name}.pkl")


def test_keypoints_of_aist_are_coco_at_60_hz(tmp_path: Path) -> None:
    walk = keypoints_of(COCO_17, 6)
    raw = {"keypoints3d": 100 * walk + 500, "keypoints3d_optim": 100 * walk}
    path = pickled(tmp_path / "a.pkl", raw)
    assert is_motion_file(path)
    body = read(path, None)
    assert (body.rate_hz, body.unit) == (60.0, "0.01 m (guessed)")
    np.testing.assert_allclose(joint(body, "lknee"), walk[:, COCO_17.index("left_knee")].T, atol=1e-4)
    for changed, words in (
        ({"keypoints3d": walk[:, :16]}, "must be numbers of shape"),
        ({"keypoints3d": [{}]}, "has no array"),
    ):
        with pytest.raises(SourceError, match=words):
            read(pickled(tmp_path / "b.pkl", changed), None)


def features_of(joints: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """The features of HumanML3D of joints (T, 22, 3) and of the root's angles (T,), worked out forward."""
    frames = len(joints)
    features = np.zeros((frames, 263))
    features[:-1, 0] = np.diff(facing) / 2
    features[:, 3] = joints[:, 0, 1]
    steps = np.diff(joints[:, 0], axis=0)
    for t in range(frames):
        # what the recovery turns back by the angle is turned by it here; the step into a frame is in that frame's axes
        turned = kinematics.rotation(1, float(np.rad2deg(facing[t])))
        if t:
            features[t - 1, [1, 2]] = (turned @ steps[t - 1])[[0, 2]]
        local = joints[t, 1:] - joints[t, 0] * [1, 0, 1]
        features[t, 4:67] = (local @ turned.T).ravel()
    return features


def test_humanml_features_give_back_the_joints_that_they_describe(tmp_path: Path) -> None:
    walk = np.repeat(rest(BODY)[None], 9, axis=0) + np.random.default_rng(0).normal(0, 0.005, (9, 22, 3))
    walk[:, :, 2] += 0.05 * np.arange(9)[:, None]
    walk -= walk[0, 0] * [1, 0, 1]
    np.save(tmp_path / "a.npy", features_of(walk, 0.1 * np.arange(9)))
    np.save(tmp_path / "b.npy", walk)
    for name in ("a.npy", "b.npy"):
        assert reader_of(tmp_path / name).__class__.__name__ == "HumanMlReader"
        body = read(tmp_path / name, None)
        assert body.rate_hz == 20.0
        for ours, theirs in {"root": "pelvis", "lknee": "left_knee", "rwrist": "right_wrist", "neck": "neck"}.items():
            np.testing.assert_allclose(joint(body, ours), walk[:, BODY.index(theirs)].T, atol=1e-4)
        assert read(tmp_path / name, None, rate_hz=12.5).rate_hz == 12.5
    np.save(tmp_path / "c.npy", np.zeros((9, 262)))
    assert reader_of(tmp_path / "c.npy").__class__.__name__ == "PositionsReader"
