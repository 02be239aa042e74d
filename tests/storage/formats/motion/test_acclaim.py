"""Acclaim files: every notation that real files use, and every fault named with its file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops import textnumbers
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import read_asf
from tests.acclaim_files import SKELETON, amc_text, asf_text, rest
from tests.oracles import kinematics as oracle

METRES = 0.0254 / 0.45


def write(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("latin-1"))
    return path


def positions(tmp_path: Path, asf: str, amc: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    skeleton = read_asf(write(tmp_path / "a.asf", asf))
    motion = AmcFile(write(tmp_path / "a.amc", amc), skeleton)
    nodes, orientation = kinematics.forward(skeleton.nodes, motion.channels())
    return {name: nodes[i].T for name, i in skeleton.bones.items()}, orientation


def random_frames(seed: int, frames: int) -> list[dict[str, list[float]]]:
    random = np.random.default_rng(seed)
    return [
        {"root": random.normal(0, 40, 6).tolist()}
        | {
            name: random.normal(0, 40, len(bone["dofs"])).tolist()
            for name, bone in SKELETON["bones"].items()
            if bone["dofs"]
        }
        for _ in range(frames)
    ]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), axis=st.permutations("XYZ"), order=st.permutations("xyz"))
def test_bones_end_where_the_rules_of_the_format_put_them(
    tmp_path_factory: pytest.TempPathFactory, seed: int, axis: list[str], order: list[str]
) -> None:
    skeleton = SKELETON | {
        "root_axis": "".join(axis),
        "root_orientation": [10.0, -20.0, 35.0],
        "root_position": [1.0, 2.0, 3.0],
        "root_order": ["r" + order[0], "tz", "r" + order[1], "tx", "r" + order[2], "ty"],
    }
    frames = random_frames(seed, 3)
    found, _ = positions(tmp_path_factory.mktemp("fk"), asf_text(skeleton), amc_text(frames))
    for t, frame in enumerate(frames):
        for name, expected in oracle.pose(skeleton, frame, METRES).items():
            np.testing.assert_allclose(found[name][t], expected, atol=1e-9)


def test_bones_may_move_and_stretch(tmp_path: Path) -> None:
    thigh = SKELETON["bones"]["thigh"] | {"dofs": ["tx", "ty", "tz", "rx", "ry", "rz", "l"]}
    skeleton = SKELETON | {"bones": SKELETON["bones"] | {"thigh": thigh}}
    frames = [frame | {"thigh": [1.0, 2.0, -1.0, 10.0, 20.0, 30.0, 0.5]} for frame in random_frames(1, 2)]
    found, _ = positions(tmp_path, asf_text(skeleton), amc_text(frames))
    for t, frame in enumerate(frames):
        expected = oracle.pose(skeleton, frame, METRES)
        np.testing.assert_allclose(found["shin"][t], expected["shin"], atol=1e-9)


def test_more_frames_than_a_block_are_worked_on_alike(tmp_path: Path) -> None:
    frames = random_frames(5, 2) * (kinematics.BLOCK + 3)
    found, orientation = positions(tmp_path, asf_text(), amc_text(frames))
    assert len(found["shin"]) == len(frames)
    np.testing.assert_array_equal(found["shin"][::2], np.broadcast_to(found["shin"][0], found["shin"][::2].shape))
    np.testing.assert_array_equal(orientation[:, 1], orientation[:, -1])


def test_radians_mean_the_same_pose_as_degrees(tmp_path: Path) -> None:
    frames = random_frames(2, 2)
    skeleton = SKELETON | {
        "bones": {name: bone | {"axis": np.deg2rad(bone["axis"]).tolist()} for name, bone in SKELETON["bones"].items()}
    }
    radians = [
        {
            name: v[:3] + np.deg2rad(v[3:]).tolist() if name == "root" else np.deg2rad(v).tolist()
            for name, v in f.items()
        }
        for f in frames
    ]
    one, _ = positions(tmp_path, asf_text(), amc_text(frames))
    two, _ = positions(tmp_path, asf_text(skeleton, angle="rad"), amc_text(radians, header=":RADIANS\n"))
    np.testing.assert_allclose(one["shin"], two["shin"], atol=1e-9)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_line_ends_blank_lines_comments_and_order_of_bones_do_not_matter(tmp_path: Path, newline: str) -> None:
    frames = random_frames(3, 3)
    plain, _ = positions(tmp_path, asf_text(), amc_text(frames))
    shuffled = [dict(reversed(frame.items())) for frame in frames]
    text = amc_text(shuffled, header="# caf\xe9\n:FULLY-SPECIFIED\n\n:DEGREES\n", newline=newline)
    text = text.replace(f"{newline}2{newline}", f"{newline}# between{newline}{newline}  2  {newline}")
    odd, _ = positions(tmp_path, asf_text(newline=newline), text.rstrip())
    np.testing.assert_array_equal(plain["shin"], odd["shin"])


def test_a_take_that_begins_at_a_later_frame_says_so(tmp_path: Path) -> None:
    text = amc_text(rest(2)).replace("\n1\n", "\n1368\n").replace("\n2\n", "\n1369\n")
    skeleton = read_asf(write(tmp_path / "a.asf", asf_text()))
    motion = AmcFile(write(tmp_path / "a.amc", text), skeleton)
    motion.channels()
    assert motion.warnings == ("frame numbers begin at 1368; its source frame here is 0",)


AMC_FAULTS = {
    "cut off in a frame": (
        lambda text: text[: text.rindex("spine")],
        17,
        "ends in the middle of a frame: bone 'spine'",
    ),
    "cut off in a line": (
        lambda text: text[: text.rindex("spine") + 9],
        17,
        "bone 'spine' has 1 numbers, a.asf gives it 2",
    ),
    "cut off in a name": (lambda text: text[: text.rindex("spine") + 3], 17, "the file ends in 'spi'"),
    "a missing bone": (lambda text: text.replace("shin 0.0\n", "", 1), 7, "lacks bone 'shin'"),
    "a bone twice": (lambda text: text.replace("shin 0.0\n", "shin 0.0\nshin 0.0\n", 1), 7, "'shin' stands twice"),
    "a non-number": (lambda text: text.replace("17.0", "17.O", 1), 4, "not a number: '17.O'"),
    "a NaN": (lambda text: text.replace("17.0", "nan", 1), 4, "not a number: 'nan'"),
    "a number beyond all": (lambda text: text.replace("17.0", "1e999", 1), 4, "not a number: '1e999'"),
    "an unknown bone": (lambda text: text.replace("shin", "shins", 1), 6, "'shins' is not in a.asf"),
    "a number too many": (lambda text: text.replace("shin 0.0", "shin 0.0 1.0", 1), 6, "unexpected '1.0'"),
    "a missing frame": (lambda text: text.replace("\n2\n", "\n3\n", 1), 8, "frame 3 follows frame 1"),
    "no frames": (lambda _: ":FULLY-SPECIFIED\n:DEGREES\n", 3, "no frames"),
    "another format": (lambda _: "HIERARCHY\nROOT Hips\n", 1, "expected a frame number, got 'HIERARCHY'"),
    "an empty file": (lambda _: "  \n", None, "the file is empty"),
}


@pytest.mark.parametrize("fault", AMC_FAULTS)
def test_a_fault_in_an_amc_file_is_named_with_its_line(tmp_path: Path, fault: str) -> None:
    break_it, line, message = AMC_FAULTS[fault]
    skeleton = read_asf(write(tmp_path / "a.asf", asf_text()))
    path = write(tmp_path / "a.amc", break_it(amc_text(rest())))
    with pytest.raises(SourceError) as caught:
        AmcFile(path, skeleton).channels()
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert caught.value.line == line


ASF_FAULTS = {
    "no bones": (lambda text: text[: text.index(":bonedata\n")], None, "no :bonedata"),
    "no hierarchy": (lambda text: text[: text.index(":hierarchy")], None, "no :hierarchy"),
    "cut off in a bone": (lambda text: text[: text.index("     name shin")], "  begin", "cut off"),
    "a length in words": (lambda text: text.replace("length 7.5", "length long"), "long", "length must be 1 numbers"),
    "a wrong axis order": (lambda text: text.replace("ZYX", "ZZX"), "ZZX", "permutation of XYZ"),
    "an unknown dof": (lambda text: text.replace("dof rx ry rz", "dof rx rq rz"), "rq", "dof must name"),
    "a negative unit": (lambda text: text.replace("length 0.45", "length -1"), "length -1", "length must be positive"),
    "a unit of nothing": (lambda text: text.replace("length 0.45", "length 1e-300"), "1e-300", "at least 1e-09"),
    "a huge length": (lambda text: text.replace("length 7.5", "length 1e300"), "1e300", "1 numbers of at most 1e+09"),
    "a dof without end": (lambda text: text.replace("dof rx", "dof " + 9000 * "rx", 1), "rxrx", "… (18004 characters)"),
    "an unknown bone": (lambda text: text.replace("hip thigh", "hip thig"), "hip thig", "did you mean 'thigh'"),
    "a bone without parent": (lambda text: text.replace("    thigh shin\n", ""), "id 3", "bone 'shin' has no parent"),
    "a bone twice": (lambda text: text.replace("name shin", "name thigh"), "id 3", "a second bone named 'thigh'"),
}


@pytest.mark.parametrize("fault", ASF_FAULTS)
def test_a_fault_in_an_asf_file_is_named_with_its_line(tmp_path: Path, fault: str) -> None:
    break_it, marker, message = ASF_FAULTS[fault]
    text = break_it(asf_text())
    path = write(tmp_path / "a.asf", text)
    with pytest.raises(SourceError) as caught:
        read_asf(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    if marker is not None:
        lines = [number for number, line in enumerate(text.splitlines(), 1) if marker in line]
        # A bone's own faults are those of the line where it begins.
        assert caught.value.line in (lines[-1], lines[-1] - 1)


def test_a_missing_file_is_a_source_error(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="cannot be read: No such file"):
        read_asf(tmp_path / "none.asf")


def parse_number(token: str) -> float:
    values, _, fault = textnumbers.parse_frames(f"1\nx {token}\n".encode(), 0, 1, ["x"], [1])
    assert fault is None, fault
    return float(values[0, 0])


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(deadline=None)
def test_numbers_are_rounded_as_python_rounds_them(value: float) -> None:
    for token in (repr(value), f"{value:.6e}", f"{value:.3f}" if abs(value) < 1e15 else repr(value)):
        assert parse_number(token) == float(token)


@given(st.from_regex(r"[+-]?([0-9]{1,30}(\.[0-9]{0,30})?|\.[0-9]{1,30})([eE][+-]?[0-9]{1,2})?", fullmatch=True))
@settings(deadline=None)
def test_every_notation_of_a_number_is_read_exactly(token: str) -> None:
    assert parse_number(token) == float(token)


@given(st.text(alphabet="0123456789.+-eE", min_size=1, max_size=8))
@settings(deadline=None)
def test_what_python_takes_for_no_number_is_none_here(token: str) -> None:
    try:
        expected: float | None = float(token)
    except ValueError:
        expected = None
    values, _, fault = textnumbers.parse_frames(f"1\nx {token}\n".encode(), 0, 1, ["x"], [1])
    if expected is None or np.isinf(expected):
        assert fault is not None
        assert fault.code == textnumbers.BAD_NUMBER
    else:
        assert fault is None
        assert values[0, 0] == expected


@given(st.lists(st.sampled_from(["\n", "\r", "\r\n", "\n\n", "\r\r", " \r"]), min_size=1, max_size=40))
@settings(deadline=None)
def test_line_ends_may_be_mixed_in_one_file(ends: list[str]) -> None:
    frames = len(ends) // 2
    text = "".join(f"{t + 1}{ends[2 * t]}root {t} 2 3{ends[2 * t + 1]}" for t in range(frames))
    values, _, fault = textnumbers.parse_frames(text.encode(), 0, 1, ["root"], [3])
    assert fault is None
    assert values[:, 0].tolist() == list(range(frames))


@given(data=st.binary(max_size=300))
@settings(deadline=None, max_examples=200)
def test_any_bytes_end_in_frames_or_a_fault(data: bytes) -> None:
    values, _, fault = textnumbers.parse_frames(b"1\nx 1 2\n" + data, 0, 1, ["x", "yy"], [2, 1])
    assert fault is not None or len(values) >= 0
