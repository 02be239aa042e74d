"""Files of joint positions: TRC, CSV, NPZ and NPY, their gaps, their rates, and every fault with its place."""

from __future__ import annotations

import contextlib
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings, load_skeleton
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.body import features, kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import numpy_arrays as stored
from kinedex.storage.formats.motion.positions import is_positions_csv, parse_positions
from kinedex.storage.formats.motion.reader import Body, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import STANDING, index, standing, turned

FEATURES = load_feature_set()
JOINTS = FEATURES.joints
AUTO = load_mappings("auto", JOINTS)
COCO = load_skeleton("coco-17", JOINTS).order
SMPL = load_skeleton("smpl-24", JOINTS).order
AT_30 = ReadSettings(rate_hz=30.0)


def keypoints(order: tuple[str, ...], frames: int) -> np.ndarray:
    """A standing figure that walks along Z as (frames, points, 3) in metres."""
    fitting = {name: joint for joint in JOINTS for name in _nodes(order, joint)}
    extra = {
        "nose": "head",
        "left_eye": "head",
        "right_eye": "head",
        "left_ear": "head",
        "right_ear": "head",
        "spine3": "chest",
    }
    pose = np.array([STANDING[fitting.get(name, extra.get(name, "root"))] for name in order], dtype=float)
    walk = np.repeat(pose[None], frames, axis=0)
    walk[:, :, 2] += np.arange(frames)[:, None] * 0.01
    return walk


def _nodes(order: tuple[str, ...], joint: str) -> list[str]:
    mapping = load_skeleton("coco-17" if order == COCO else "smpl-24", JOINTS)
    return [mix.node for mix in mapping.joints[joint] if mix is not None and mix.node is not None]


def trc(
    points: np.ndarray, names: tuple[str, ...], *, rate: str = "60.00", units: str = "mm", step: float = 1 / 60
) -> str:
    frames = len(points)
    lines = ["PathFileType\t4\t(X/Y/Z)\ta.trc"]
    lines += ["DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"]
    lines += [f"{rate}\t60.00\t{frames}\t{len(names)}\t{units}\t60.00\t1\t{frames}"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t"]
    lines += ["\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, len(names) + 1)), ""]
    for t, row in enumerate(points):
        cells = ["" if np.isnan(x) else f"{x:.6g}" for x in row.ravel()]
        lines.append(f"{t + 1}\t{t * step:.4f}\t" + "\t".join(cells))
    return "\n".join(lines) + "\n"


def csv_text(points: np.ndarray, names: tuple[str, ...]) -> str:
    lines = [",".join(["frame", *(f"{name}_{axis}" for name in names for axis in "xyz")])]
    lines += [",".join([str(t), *(repr(float(x)) for x in row.ravel())]) for t, row in enumerate(points)]
    return "\n".join(lines) + "\n"


def write(path: Path, content: str) -> Path:
    path.write_text(content)
    return path


def read(path: Path, given: ReadSettings = AT_30) -> Body:
    return read_body(path, None, AUTO, JOINTS, given)


def test_the_same_walk_comes_in_from_every_form(tmp_path: Path) -> None:
    walk = keypoints(COCO, 12)
    paths = [write(tmp_path / "a.trc", trc(1000 * walk, COCO)), write(tmp_path / "a.csv", csv_text(walk, COCO))]
    paths += [tmp_path / name for name in ("a.npy", "plain.npz", "full.npz")]
    np.save(paths[2], walk.astype(np.float32))
    np.savez(paths[3], keypoints_3d=walk)
    np.savez(paths[4], positions=walk[:, ::-1], names=np.array(COCO[::-1]), fps=60)
    bodies = [read(path) for path in paths]
    assert [body.rate_hz for body in bodies] == [60.0, 30.0, 30.0, 30.0, 60.0]
    for body in bodies:
        assert body.skeleton == "recognised points"
        assert body.unknown == ("ltoes", "rtoes")
        np.testing.assert_allclose(body.positions, bodies[1].positions, atol=1e-5)
        np.testing.assert_allclose(np.abs(body.orientation[0]), 1.0, atol=0.01)
    np.testing.assert_allclose(bodies[0].positions[index("lwrist"), :, 5], [0.27, 0.85, 0.07], atol=1e-5)
    np.testing.assert_allclose(bodies[0].positions[index("root"), :, 0], [0.0, 1.0, -0.07], atol=0.02)
    assert bodies[0].unit == "0.001 m"
    assert bodies[1].unit == "1 m (guessed)"
    assert any("does not name its joints" in warning for warning in bodies[2].warnings)


def test_smpl_joints_come_in_by_name_and_by_order(tmp_path: Path) -> None:
    walk = keypoints(SMPL, 3)
    np.save(tmp_path / "a.npy", walk)
    by_order, by_name = read(tmp_path / "a.npy"), read(write(tmp_path / "a.csv", csv_text(walk, SMPL)))
    assert (by_order.skeleton, by_order.unknown) == ("recognised points", ())
    assert any("in the order of mapping 'smpl-24'" in warning for warning in by_order.warnings)
    np.testing.assert_array_equal(by_order.positions, by_name.positions)
    np.testing.assert_allclose(by_name.positions[index("lfingers"), :, 0], STANDING["lfingers"])


def test_the_root_turns_as_hips_and_spine_do(tmp_path: Path) -> None:
    degrees = np.arange(20) * 5.0
    matrices = np.stack([kinematics.rotation(1, float(angle)) for angle in degrees])
    positions = np.einsum("tab,jbt->tja", matrices, standing(20))
    body = read(write(tmp_path / "a.csv", csv_text(positions, JOINTS)))
    assert (body.skeleton, body.unknown, body.warnings) == ("named-positions", (), ())
    np.testing.assert_allclose(body.orientation, turned(degrees), atol=1e-6)
    words = features.words(body.positions, body.orientation, 30.0, FEATURES.rules)
    assert ((words >> np.uint64(39)) & np.uint64(1))[:-1].all()  # 150 degrees a second


def test_joints_that_a_file_never_shows_are_unknown(tmp_path: Path) -> None:
    positions = np.moveaxis(standing(4), 2, 0).copy()
    positions[:, [index("ltoes"), index("belly")]] = np.nan
    body = read(write(tmp_path / "a.csv", csv_text(positions, JOINTS)))
    assert body.unknown == ("ltoes", "belly")
    assert np.isfinite(body.orientation).all()


def test_long_gaps_make_frames_invalid_and_short_ones_are_closed(tmp_path: Path) -> None:
    walk = keypoints(COCO, 24)
    gap = walk.copy()
    gap[4:7, COCO.index("left_wrist"), 1] = np.nan
    gap[12:20, COCO.index("left_hip"), 0] = np.nan
    gap[2, COCO.index("nose")] = np.nan  # nothing takes it
    path = write(tmp_path / "a.trc", trc(1000 * gap, COCO))
    body = read(path)  # at 60 Hz, a tenth of a second is six frames
    assert body.valid is not None
    assert np.flatnonzero(~body.valid).tolist() == list(range(12, 20))
    assert body.warnings[-2:] == (
        "gaps closed along straight lines: left_wrist 3 frames (longest 3)",
        "8 of 24 source frames are invalid and have no word; points that the mapping 'recognised points' takes are "
        "missing for more than 6 frames: left_hip 8 frames (longest 8); `fill_gap_frames: 8` closes all gaps along "
        "straight lines; `kinedex stabilise` fills them by the motion around them and by what the archive knows",
    )
    assert np.isnan(body.orientation).any(axis=0).tolist() == (~body.valid).tolist()
    whole = read(write(tmp_path / "b.trc", trc(1000 * walk, COCO)))
    np.testing.assert_allclose(body.positions[:, :, body.valid], whole.positions[:, :, body.valid], atol=1e-5)
    closed = read(path, ReadSettings(fill_gap_frames=8))
    assert closed.valid is None
    np.testing.assert_allclose(closed.positions, whole.positions, atol=1e-5)
    none = read(path, ReadSettings(fill_gap_frames=0)).valid
    assert none is not None
    assert np.count_nonzero(~none) == 11


def test_rates_that_contradict_each_other_are_said_and_missing_ones_asked_for(tmp_path: Path) -> None:
    walk = keypoints(COCO, 8)
    output = read(write(tmp_path / "a.trc", trc(1000 * walk, COCO, step=1 / 50)), ReadSettings())
    assert output.rate_hz == 60.0
    assert "it is read at 60 Hz, but by the times in the file it is 50 Hz" in output.warnings
    other = read(tmp_path / "a.trc", ReadSettings(override_rate_hz=50.0))
    assert (other.rate_hz, other.warnings[-1]) == (50.0, "the file states 60 Hz; it is read at 50 Hz, which was given")
    with pytest.raises(SourceError, match="does not state its frames per second: give `rate_hz`"):
        read(write(tmp_path / "a.csv", csv_text(walk, COCO)), ReadSettings())


_POINTS = ("", "\t\t\t", "\t1\t2\t3", "\t\t\t\t4\t5\t6")
QUIRKS = {
    "commas": (lambda text: text.replace("\t", ","), ()),
    "commas to the end of every line": (lambda text: text.replace("\t", ",").replace("\n", ",,,\n"), ()),
    "blank lines in the header": (
        lambda text: "\n".join(f"{line}\n" for line in text.split("\n")[:5]) + text[_rows(text) :], (),
    ),
    "no PathFileType": (lambda text: text.split("\n", 1)[1], ()),
    "no line of axes": (lambda text: "\n".join(line for line in text.split("\n") if "X1" not in line), ()),
    "a rate of 0": (lambda text: text.replace("60.00", "0", 1), ("by its times it is 60 Hz",)),
    "no rate": (lambda text: text.replace("DataRate", "Rate", 1), ("by its times it is 60 Hz",)),
    "no unit": (
        lambda text: text.replace("Units\t", "").replace("\tmm\t", "\t"),
        ("no unit of m, cm, mm, in", "is guessed: mm"),
    ),
    "an unknown unit": (lambda text: text.replace("\tmm\t", "\tell\t"), ("but 'ell'", "is guessed: mm")),
    "counts that lie": (
        lambda text: text.replace("\t20\t17\t", "\t7\t99\t"), ("states 7 frames", "states 99 markers"),
    ),
    "more columns than labels": (
        lambda text: "".join(f"{line}\t1\t2\t3\n" if line[:1].isdigit() and "mm" not in line else f"{line}\n"
                             for line in text.split("\n")), ("its rows have 18 markers, its header names 17",),
    ),
    "columns without labels in some rows": (
        lambda text: "".join(f"{line}{_POINTS[i % 4]}\n" if line[:1].isdigit() and "mm" not in line else f"{line}\n"
                             for i, line in enumerate(text.split("\n"))),
        ("its rows have up to 19 markers, its header names 17; the others, 45 cells in 10 of 20 rows",),
    ),
    "two markers of one name": (lambda text: text.replace("left_eye", "nose"), ("nose (2 copies)",)),
    "not a number": (lambda text: text.replace("\n1\t0.0000\t0\t", "\n1\t0.0000\t1.#QNAN\t"), ()),
    "a subject's name": (lambda text: text.replace("left_", "Ann:left_").replace("right_", "Ann:right_"), ()),
}  # fmt: skip


def _rows(text: str) -> int:
    return text.index("\n1\t0.0000") + 1


@pytest.mark.parametrize("quirk", QUIRKS)
def test_trc_files_come_in_as_programs_write_them(tmp_path: Path, quirk: str) -> None:
    text = trc(1000 * keypoints(COCO, 20), COCO)
    change, warnings = QUIRKS[quirk]
    assert change(text) != text
    expected = read(write(tmp_path / "a.trc", text), ReadSettings())
    body = read(write(tmp_path / "b.trc", change(text)), ReadSettings())
    assert body.rate_hz == pytest.approx(60.0, abs=0.1)
    for joint in ("lwrist", "root", "rknee", "lankle"):
        np.testing.assert_allclose(body.positions[index(joint)], expected.positions[index(joint)], atol=1e-9)
    for warning in warnings:
        assert any(warning in found for found in (*body.warnings, *body.evidence))


@pytest.mark.parametrize("axis", ["z", "-y", "x"])
def test_a_body_of_keypoints_is_turned_upright(tmp_path: Path, axis: str) -> None:
    walk = keypoints(COCO, 12)
    x, y, z = np.moveaxis(walk, 2, 0)
    turned_walk = np.stack({"z": (x, -z, y), "-y": (x, -y, -z), "x": (y, z, x)}[axis], axis=2)
    expected = read(write(tmp_path / "a.csv", csv_text(walk, COCO)))
    body = read(write(tmp_path / "b.csv", csv_text(turned_walk, COCO)))
    np.testing.assert_allclose(body.positions[:, 1], expected.positions[:, 1], atol=1e-9)
    assert any(f"up is {axis} by posture" in sentence for sentence in body.evidence)
    named = np.einsum("jat->tja", standing(4))[:, :, [0, 2, 1]] * [1, -1, 1]
    assert (
        read(write(tmp_path / "c.csv", csv_text(named, JOINTS))).evidence == ()
    )  # what kinedex exports is never turned


@pytest.mark.parametrize(("count", "name"), [(17, "left_wrist"), (22, "left wrist"), (33, "left wrist")])
def test_points_without_names_are_known_by_their_number(tmp_path: Path, count: int, name: str) -> None:
    orders = {17: COCO, **{len(order): order for order in load_landmarks().orders.values() if len(order) != 17}}
    order = orders[count]
    walk = np.stack([LIKE.get(label.replace(" ", "_"), STANDING["head"]) for label in order])[None].repeat(9, axis=0)
    np.save(tmp_path / "a.npy", walk)
    body = read(tmp_path / "a.npy")
    np.testing.assert_allclose(body.positions[index("lwrist"), :, 0], walk[0, order.index(name)])
    assert set(body.unknown) <= {"ltoes", "rtoes"}


PARTS = {"hip": "hip", "knee": "knee", "ankle": "ankle", "foot": "toes", "foot_index": "toes", "heel": "ankle",
         "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist", "index": "fingers", "pinky": "fingers",
         "collar": "clavicle", "thumb": "wrist"}  # fmt: skip
LIKE = {f"{word}_{part}": STANDING[side + joint] for word, side in (("left", "l"), ("right", "r")) for part, joint in
        PARTS.items()} | {"pelvis": STANDING["root"], "spine1": STANDING["belly"], "spine2": STANDING["chest"],
                          "spine3": (0, 1.35, 0), "neck": STANDING["neck"]}  # fmt: skip

TRC = trc(1000 * keypoints(COCO, 3), COCO)
CSV = csv_text(keypoints(COCO, 3), COCO)

FAULTS = {
    "not TRC": ("a.trc", "hello\n", 1, "expected a TRC header"),
    "numbers without a header": ("a.trc", TRC.split("\n", 6)[6], 1, "expected a TRC header: a line PathFileType"),
    "no number": ("a.trc", TRC.replace("\n2\t0.0167\t0\t", "\n2\t0.0167\tx\t"), 8, "column 'nose X': not a number"),
    "a row cut off": ("a.trc", TRC[:-12], 9, "cells, the header has 53 columns"),
    "a frame left out": ("a.trc", TRC.replace("\n2\t", "\n3\t"), 8, "expected the next frame's number after frame 1"),
    "an infinite number of Microsoft's library": (
        "a.trc", TRC.replace("\n2\t0.0167\t0\t", "\n2\t0.0167\t-1.#INF\t"), 8, "column 'nose X': '-1.#INF' is infinite"
    ),
    "a number that may be infinite": (
        "a.trc", TRC.replace("\n2\t0.0167\t0\t", "\n2\t0.0167\t1.#IO\t"), 8, "is infinite, or may be"
    ),
    "part of a point without a label": (
        "a.trc", TRC.rstrip("\n") + "\t1\t2\n", 9, "55 cells, the header has 53 columns, and the cells after"
    ),
    "time stands still": ("a.trc", TRC.replace("0.0167", "0.0000"), 8, "does not come after the last"),
    "no frames": ("a.trc", TRC.split("\n1\t")[0] + "\n", 6, "no frames"),
    "an axis without its joint": ("a.csv", CSV.replace("nose_y", "nose_w"), 1, "column 'nose_y' is missing"),
    "a column twice": ("a.csv", CSV.replace("nose_y", "nose_x"), 1, "stands twice in the header"),
    "infinity": ("a.csv", CSV.replace("\n1,0.0,", "\n1,inf,"), 3, "column 'nose_x': not a finite number"),
    "Python's own digits": ("a.csv", CSV.replace("\n1,0.0,", "\n1,1_0,"), 3, "column 'nose_x': not a number: '1_0'"),
    "a quote that is not closed": ("a.csv", CSV.replace("\n1,0.0,", '\n1,"0.0,'), 3, "column 'nose_x': not a number"),
    "a cell of any length": ("a.csv", CSV.replace("\n1,", '\n1,"' + 200_000 * "9" + '",'), 3, "column"),
    "quotes in TRC": ("a.trc", TRC.replace("\n2\t0.0167\t0\t", '\n2\t0.0167\t"x"\t'), 8, "'nose X': not a number: 'x'"),
    "huge": ("a.csv", CSV.replace("\n1,0.0,1.55,", "\n1,0.0,1e300,").replace("0.27", "1e300"), None, "km away"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_line_and_column(tmp_path: Path, fault: str) -> None:
    name, content, line, message = FAULTS[fault]
    with pytest.raises(SourceError) as caught:
        read(write(tmp_path / name, content), AT_30)
    assert message in str(caught.value)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"poses": np.zeros((3, 156)), "trans": np.zeros((3, 3))}, "holds the joint angles of a body (AMASS, SMPL)"),
        ({"position": np.zeros((3, 17, 3))}, "did you mean 'position'?"),
        ({"positions": np.zeros((3, 17, 4))}, "must be numbers of shape (frames, joints, 3), got (3, 17, 4)"),
        ({"positions": np.zeros((3, 18, 3))}, "does not name its 18 joints"),
        ({"positions": np.full((3, 17, 3), np.inf)}, "infinite numbers, the first in frame 0"),
        ({"positions": np.zeros((3, 17, 3)), "names": np.array(["a"])}, "'names' must be 17 different texts"),
        ({"positions": np.zeros((3, 17, 3)), "fps": 0}, "the rate must be one number"),
    ],
)
def test_arrays_that_are_no_positions_are_refused(tmp_path: Path, arrays: dict[str, object], message: str) -> None:
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(SourceError) as caught:
        read(tmp_path / "a.npz")
    assert message in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", b"PK\x03\x04 broken", b"\x80\x04K\x01.", b"hello"])
@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_what_is_no_array_file_is_refused_and_nothing_in_it_is_run(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SourceError):
        parse_positions(tmp_path / name)


def test_a_broken_byte_in_an_archive_of_arrays_is_a_fault_of_the_file(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", positions=keypoints(COCO, 3))
    whole = (tmp_path / "a.npz").read_bytes()
    for at in range(0, len(whole), 3):
        (tmp_path / "b.npz").write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with contextlib.suppress(SourceError):
            parse_positions(tmp_path / "b.npz")


def test_a_header_that_does_not_fit_its_file_is_refused_before_memory_is_asked_for(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", keypoints(COCO, 3))
    whole = (tmp_path / "a.npy").read_bytes()
    for shape in (b"(900000000000, 17, 3)", b"(2, 17, 3)", b"(0, 17, 3)", b"(-1, 17, 3)"):
        (tmp_path / "b.npy").write_bytes(whole.replace(b"(3, 17, 3)", shape))
        with pytest.raises(SourceError, match=r"the file must hold .* values of float64 by its header, and holds"):
            parse_positions(tmp_path / "b.npy")
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("fps.npy", b"no array at all")
        packed.writestr("positions.npy", whole)
    with pytest.raises(SourceError, match="cannot be read as NumPy arrays"):
        parse_positions(tmp_path / "c.npz")


def test_an_array_that_unpacks_to_more_than_fits_is_refused_by_its_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored, "MAX_BYTES", 1_000_000)
    np.savez_compressed(tmp_path / "a.npz", positions=np.zeros((50_000, 17, 3), np.int8))
    with pytest.raises(SourceError, match=r"'positions' takes 0\.0 GB in memory; write shorter takes"):
        parse_positions(tmp_path / "a.npz")


def test_names_that_are_no_letters_are_refused(tmp_path: Path) -> None:
    names = np.array([f"name{i:02}" for i in range(17)])
    names.view(np.uint32)[3] = 0xF0_00_00_41
    np.savez(tmp_path / "a.npz", positions=keypoints(COCO, 3), names=names)
    with pytest.raises(SourceError, match="'names' has characters that are not valid Unicode"):
        parse_positions(tmp_path / "a.npz")


def test_only_tables_of_positions_are_motion_files(tmp_path: Path) -> None:
    assert is_positions_csv(write(tmp_path / "a.csv", CSV))
    assert is_positions_csv(write(tmp_path / "a.csv", "\ufeff" + CSV.replace("_x", "_X")))
    for header in ("take,class,start,stop\n", "", "a_x,b_y,c_z\n"):
        assert not is_positions_csv(write(tmp_path / "b.csv", header))


def test_tables_of_bvh_toolbox_and_pose2sim_blender_come_in_by_their_times(tmp_path: Path) -> None:
    walk = keypoints(COCO, 8)
    header, *rows = csv_text(walk, COCO).splitlines()
    times = [f"{t / 24:.5f}" for t in range(8)]
    cells = [",".join([time, *row.split(",")[1:]]) for time, row in zip(times, rows, strict=True)]
    dotted = re.sub(r"_([xyz])(?=,|$)", r".\1", header.replace("frame", "time"))
    first = write(tmp_path / "a.csv", "\n".join([dotted, *cells, ""]))
    turned = header.replace("frame", "# times").replace("nose_x", "nose_x, nose_rotx").replace(",", ", ")
    wide = [",".join([*row.split(",")[:2], "0.5", *row.split(",")[2:]]) for row in cells]
    second = write(tmp_path / "b.csv", "\n".join([turned, *wide, ""]))
    plain = read(write(tmp_path / "c.csv", csv_text(walk, COCO)))
    for path in (first, second):
        assert is_positions_csv(path)
        body = read(path, ReadSettings())
        assert body.rate_hz == pytest.approx(24.0, rel=1e-3)
        np.testing.assert_allclose(body.positions, plain.positions, atol=1e-4)
        assert read(path, ReadSettings(rate_hz=30.0)).rate_hz == 30.0


def test_tables_of_programs_in_the_wild_come_in(shared: Path) -> None:
    folder = shared / "data" / "wild"
    for name, rate_hz in (
        ("bvh-toolbox/walk01_pos.csv", 24.0),
        ("Pose2Sim_Blender/Pose2Sim_motion.csv", 60.0),
        ("Pose2Sim_Blender/Moco_motion.csv", 30.2308),
    ):
        body = read(folder / name, ReadSettings())
        assert body.rate_hz == pytest.approx(rate_hz, rel=1e-3)
        head, feet = (body.positions[index(joint), 1].mean() for joint in ("head", "lankle"))
        assert 1.2 < head - feet < 1.8
