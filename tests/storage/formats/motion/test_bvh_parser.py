"""BVH files: every notation that real files use, and every fault named with its file and line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.bvh_parser import Bvh, frame_rate, parse_bvh
from tests.bvh_files import POSITIONS, Joint, bvh_text, dance, small, still
from tests.oracles import bvh as oracle

TEXT = bvh_text(small(), still(small()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bvh")


def parse(folder: Path, text: str | bytes) -> Bvh:
    path = folder / "a.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return parse_bvh(path)


def positions(bvh: Bvh) -> dict[str, np.ndarray]:
    positions, _ = kinematics.forward(bvh.nodes, bvh.channels)
    return {node.name: positions[i].T for i, node in enumerate(bvh.nodes)}


ORDERS = st.lists(st.permutations(["Xrotation", "Yrotation", "Zrotation"]), min_size=4, max_size=4)


@settings(max_examples=30)
@given(
    orders=ORDERS, moves=st.lists(st.permutations(POSITIONS), min_size=2, max_size=2), seed=st.integers(0, 2**32 - 1)
)
def test_joints_are_where_the_rules_of_the_format_put_them(
    folder: Path, orders: list[list[str]], moves: list[list[str]], seed: int
) -> None:
    root = small()
    hips, thigh, shin, foot = root, *(joint for joint in root.all() if joint.name in ("thigh", "shin", "foot"))
    hips.channels = (*moves[0], *orders[0])
    thigh.channels = tuple(orders[1])
    shin.channels = (*orders[2][:2], *moves[1], orders[2][2])
    foot.channels = tuple(orders[3][:2])
    random = np.random.default_rng(seed)
    frames = [{j.name: random.normal(0, 60, len(j.channels)).tolist() for j in root.all()} for _ in range(3)]
    bvh = parse(folder, bvh_text(root, frames))
    found = positions(bvh)
    for t, frame in enumerate(frames):
        expected, orientations = oracle.pose(root, frame)
        assert set(expected) == set(found)
        for name, place in expected.items():
            np.testing.assert_allclose(found[name][t], place, atol=1e-9)
        for i, node in enumerate(bvh.nodes):
            if node.name in orientations:
                _, matrices = kinematics.forward(bvh.nodes, bvh.channels, i)
                np.testing.assert_allclose(matrices[:, t].reshape(3, 3), orientations[node.name], atol=1e-12)


def test_position_channels_stand_in_the_place_of_the_offset_axis_by_axis(folder: Path) -> None:
    root = Joint("hips", (1, 90, -3), ("Yposition",), [Joint("spine", (5, 6, 7), ("Zposition", "Xposition"))])
    found = positions(parse(folder, bvh_text(root, [{"hips": [80.0], "spine": [1.0, 2.0]}])))
    np.testing.assert_array_equal(found["hips"], [[1, 80, -3]])
    np.testing.assert_array_equal(found["spine"], [[3, 86, -2]])


def test_end_sites_are_nodes_and_those_of_no_length_say_nothing(folder: Path) -> None:
    bvh = parse(folder, TEXT)
    names = [node.name for node in bvh.nodes]
    assert names == ["hips", "thigh", "shin", "foot", "foot_end", "foot_end2", "spine", "twist", "head", "head_end"]
    assert set(names) - set(bvh.indices) == {"head_end"}


def on_one_line(text: str) -> str:
    """Braces and settings of the hierarchy one after the other on the same line; a name ends its line or at a brace."""
    head, motion = text.split("MOTION")
    return re.sub(r"\n\s*(?=[{}]|OFFSET|CHANNELS)", " ", head) + "MOTION" + motion


NOTATIONS = {
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "old Mac line ends": lambda text: text.replace("\n", "\r"),
    "no line end at the end": lambda text: text.rstrip(),
    "tabs": lambda text: text.replace("  ", "\t").replace("Frames: ", "Frames:\t").replace("Time: ", "Time:\t"),
    "braces behind the name": on_one_line,
    "blank lines": lambda text: text.replace("\n", "\n\n"),
    "spaces at the ends of lines": lambda text: text.replace("\n", "  \n"),
    "comments": lambda text: text.replace("OFFSET 0 -7 0.5", "# OFFSET 9 9 9\n OFFSET 0 -7 0.5 // foot").replace(
        "0.0333333\n", "0.0333333\n# here it begins\n"
    ),
    "capital and small letters": lambda text: text.replace("CHANNELS", "Channels").replace("Zrotation", "ZROTATION"),
    "scientific notation": lambda text: text.replace("90.0", "9.0e+1").replace("-7.5", "-75E-1"),
    "a byte order mark": lambda text: "\ufeff" + text,
    "a point at the end of numbers": lambda text: re.sub(r"\b90\.0\b", "90.", text),
}


@pytest.mark.parametrize("notation", NOTATIONS)
def test_the_same_motion_is_read_from_every_notation(folder: Path, notation: str) -> None:
    text = bvh_text(small(), dance(small(), 5))
    other = NOTATIONS[notation](text)
    assert other != text
    plain, odd = parse(folder, text), parse(folder, other)
    assert odd.warnings == ()
    assert [node.name for node in odd.nodes] == [node.name for node in plain.nodes]
    np.testing.assert_array_equal(odd.channels, plain.channels)
    for one, two in zip(plain.nodes, odd.nodes, strict=True):
        np.testing.assert_array_equal(one.before, two.before)


def test_names_keep_prefixes_spaces_and_letters_of_every_code_page(folder: Path) -> None:
    names = {"thigh": "mixamorig:Left Up Leg", "shin": "下半身", "foot": "Pied \xe9"}
    text = TEXT
    for old, new in names.items():
        text = text.replace(f"JOINT {old}", f"JOINT {new}")
    assert set(names.values()) < set(parse(folder, text).indices)
    assert "Pied \xe9" in parse(folder, text.replace("下半身", "x").encode("latin-1")).indices


def test_joints_of_one_name_are_told_apart_and_said(folder: Path) -> None:
    bvh = parse(folder, TEXT.replace("JOINT shin", "JOINT foot").replace("JOINT twist", "JOINT foot_end"))
    assert [name for name in bvh.indices if "foot" in name] == [
        "foot",
        "foot#2",
        "foot#2_end",
        "foot#2_end2",
        "foot_end",
    ]
    assert bvh.warnings == (
        "several joints have one name ('foot'); the second of them is read as '<name>#2', and so on",
    )


@pytest.mark.parametrize("claimed", [1, 2, 4, 10**9, 10**17])
def test_a_wrong_count_of_frames_is_said_and_the_frames_are_kept(folder: Path, claimed: int) -> None:
    bvh = parse(folder, bvh_text(small(), still(small(), 3), claimed=claimed))
    assert len(bvh.channels) == 3
    assert bvh.warnings == (f"the header states {claimed} frames, the file holds 3, which are kept",)


def test_a_short_file_whose_last_line_has_no_end_may_be_cut_off_in_its_last_number(folder: Path) -> None:
    (warning,) = parse(folder, bvh_text(small(), still(small(), 3), claimed=4).rstrip()).warnings
    assert warning.endswith("which are kept; its last line has no end")


@pytest.mark.parametrize(
    ("frame_time", "rate_hz"),
    [
        *[(time, 120.0) for time in (".0083333", "0.008333", "0.00833", "0.0083", "8.33e-03", "0.008333333767950535")],
        *[(time, 30.0) for time in ("0.0333333", "0.033333", "0.0333", "0.033", "0.03333333507180214", "0.0333333333")],
        *[(time, 60.0) for time in ("0.016667", "0.0166667", "0.0166", "0.0167", "0.017")],
        *[(time, 24.0) for time in ("0.0416667", "0.041667", "0.0417")],
        *[(time, 30000 / 1001) for time in ("0.0333667", "0.033367", "0.03337")],
        ("0.04", 25.0), ("0.02", 50.0), ("0.01", 100.0), ("0.005", 200.0), ("0.004167", 240.0), ("0.0041666", 240.0),
        ("0.008", 125.0), ("0.0111111", 90.0), ("0.1", 10.0), ("0.03", 1 / 0.03), ("0.0125", 80.0), ("1", 1.0),
    ],
)  # fmt: skip
def test_a_frame_time_of_few_digits_stands_for_the_usual_rate(folder: Path, frame_time: str, rate_hz: float) -> None:
    assert frame_rate(frame_time) == pytest.approx(rate_hz, rel=1e-12)
    bvh = parse(folder, bvh_text(small(), still(small()), frame_time=frame_time))
    assert bvh.rate_hz == frame_rate(frame_time)
    bent = abs(rate_hz * float(frame_time) - 1) > 1e-3
    assert bvh.warnings == ((f"frame time {frame_time} is read as {rate_hz:.6g} Hz",) if bent else ())


@given(st.sampled_from([24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0, 500.0]), st.integers(5, 17))
def test_usual_rates_come_back_however_many_digits_are_written_or_cut(rate_hz: float, digits: int) -> None:
    rounded = f"{1 / rate_hz:.{digits}f}"
    assert frame_rate(rounded) == rate_hz
    assert frame_rate(f"{1 / rate_hz:.20f}"[: digits + 2]) == rate_hz


@pytest.mark.parametrize(("frame_time", "rate_hz"), [("33.333", 30.0), ("16.67", 60.0), ("8.33", 120.0), ("40", 25.0)])
def test_a_frame_time_of_many_seconds_is_one_in_milliseconds(folder: Path, frame_time: str, rate_hz: float) -> None:
    bvh = parse(folder, bvh_text(small(), still(small()), frame_time=frame_time))
    assert bvh.rate_hz == rate_hz
    assert bvh.warnings == (f"frame time {frame_time} is read as milliseconds: {rate_hz:g} Hz",)


END = "the end of the file"

FAULTS = {
    "another format": (lambda _: ":FULLY-SPECIFIED\n", ":FULLY", "expected HIERARCHY, got ':FULLY-SPECIFIED'"),
    "an empty file": (lambda _: " \n", None, "the file is empty"),
    "no root": (lambda text: text.replace("ROOT", "ROT"), "ROT", "expected ROOT, got 'ROT'; did you mean 'ROOT'?"),
    "a root inside": (lambda text: text.replace("JOINT shin", "ROOT shin"), "ROOT shin", "inside another joint"),
    "a joint without name": (lambda text: text.replace("JOINT shin", "JOINT"), "JOINT\n", "JOINT has no name"),
    "no brace": (
        lambda text: re.sub(r"shin\s+{", "shin", text),
        "OFFSET 0.3",
        "expected '{' after JOINT shin",
    ),
    "a brace too few": (
        lambda text: text.replace("}\nMOTION", "MOTION"),
        "MOTION",
        "MOTION before joint 'hips' (line 2) is closed",
    ),
    "a brace too many": (lambda text: text.replace("}\nMOT", "}\n}\nMOT"), "}\nMOT", "expected MOTION, got '}'"),
    "no OFFSET": (lambda text: text.replace("OFFSET 0.3 -7.5 0\n", "\n"), "JOINT shin", "joint 'shin' has no OFFSET"),
    "two OFFSETs": (
        lambda text: text.replace("OFFSET 0.3", "OFFSET 1 1 1 OFFSET 0.3"),
        "OFFSET 0.3",
        "a second OFFSET of joint 'shin'",
    ),
    "an OFFSET in words": (
        lambda text: text.replace("OFFSET 0.3", "OFFSET far"),
        "OFFSET far",
        "OFFSET of joint 'shin' must be a number, got 'far'",
    ),
    "an OFFSET of two numbers": (
        lambda text: text.replace("OFFSET 0.3 -7.5 0\n", "OFFSET 0.3 -7.5\n"),
        "CHANNELS 6 Xposition Yposition Zposition Xrotation",
        "OFFSET of joint 'shin' must be a number, got 'CHANNELS'",
    ),
    "a NaN": (lambda text: text.replace("OFFSET 0.3", "OFFSET nan"), "OFFSET nan", "must be a number, got 'nan'"),
    "an unknown channel": (
        lambda text: text.replace("3 Yrotation", "3 Yrotatoin"),
        "Yrotatoin",
        "got 'Yrotatoin'; did you mean 'Yrotation'?",
    ),
    "fewer channels than said": (
        lambda text: text.replace("CHANNELS 1 Yrotation", "CHANNELS 2 Yrotation"),
        "JOINT head",
        "joint 'twist' has 2 channels; expected one, got 'JOINT'",
    ),
    "a channel twice": (
        lambda text: text.replace("3 Yrotation Xrotation", "3 Yrotation Yrotation"),
        "3 Yrotation Yrotation",
        "joint 'foot' has channel Yrotation twice",
    ),
    "nine channels": (lambda text: text.replace("CHANNELS 1", "CHANNELS 9"), "CHANNELS 9", "must be 0 to 6, got 9"),
    "a joint below an End Site": (
        lambda text: text.replace("OFFSET 0 -1 2", "OFFSET 0 -1 2\nJOINT x {\nOFFSET 0 0 0 }\n"),
        "JOINT x",
        "an End Site has no joints below it",
    ),
    "no motion": (lambda text: text[: text.index("MOTION")], END, "ends in its hierarchy, before MOTION"),
    "no Frames": (lambda text: re.sub("Frames.*\n", "", text), "Frame Time", "expected 'Frames: <how many>'"),
    "frames in words": (lambda text: text.replace("Frames: 3", "Frames: many"), "Frames: many", "a whole number"),
    "a negative count": (lambda text: text.replace("Frames: 3", "Frames: -3"), "Frames: -3", "number, got '-3'"),
    "no frame time": (lambda text: re.sub("Frame Time.*\n", "", text), "1.0 90.0", "expected 'Frame Time: <seconds>'"),
    "a frame time of nothing": (lambda text: text.replace("0.0333333", ""), "Frame Time", "of seconds, got ''"),
    "a frame time of zero": (lambda text: text.replace("0.0333333", "0.0"), "Frame Time", "to 1 seconds, got 0.0"),
    "a negative frame time": (lambda text: text.replace("0.0333333", "-0.03"), "Frame Time", "to 1 seconds, got -0.03"),
    "frames by the year": (lambda text: text.replace("0.0333333", "1e9"), "Frame Time", "got 1e9; write 0.0333333"),
    "a decimal comma": (lambda text: text.replace("0.0333333", "0,0333"), "Frame Time", "seconds, got '0,0333'"),
    "no frames": (lambda text: text[: text.index("0.0333333") + 10], "Frame Time", "after its header, which states 3"),
    "a frame cut off": (lambda text: text[:-8], "1.0 90.0 -1.0", "the file is cut off in the middle of a frame"),
    "a short line": (
        lambda text: text.replace("1.0 90.0 -2.0", "1.0 90.0", 1),
        "1.0 90.0 0.0",
        "frame 1 has 20 numbers, the hierarchy has 21 channels",
    ),
    "a long line": (lambda text: text.replace("1.0 90.0", "1.0 7.0 90.0", 1), "7.0", "more numbers than the 21"),
    "a non-number": (lambda text: text.replace("90.0", "9O.0", 1), "9O.0", "not a number: '9O.0'"),
    "an infinite number": (lambda text: text.replace("90.0", "1e400", 1), "1e400", "not a number: '1e400'"),
    "nothing that moves": (
        lambda text: re.sub("CHANNELS.*", "", text),
        "ROOT",
        "no joint of the hierarchy has CHANNELS",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_line(folder: Path, fault: str) -> None:
    break_it, where, message = FAULTS[fault]
    text = break_it(TEXT)
    assert text != TEXT
    with pytest.raises(SourceError) as caught:
        parse(folder, text)
    assert message in str(caught.value)
    assert str(folder / "a.bvh") in str(caught.value)
    if isinstance(where, str) and where != END:
        lines = [text[: found.start()].count("\n") + 1 for found in re.finditer(re.escape(where), text)]
        assert caught.value.line in lines
    else:
        assert caught.value.line == (None if where is None else text.count("\n") + 1)


def test_a_frame_that_is_cut_off_is_an_error_only_the_last_one_says_that_the_file_is(folder: Path) -> None:
    lines = TEXT.splitlines()
    lines[-2] = lines[-2][:-4]
    with pytest.raises(SourceError, match=r"has 20 numbers, the hierarchy has 21 channels$"):
        parse(folder, "\n".join(lines))


def test_a_very_deep_chain_is_read_and_an_absurd_one_refused(folder: Path) -> None:
    def chain(depth: int) -> str:
        joints = "".join(f"{'JOINT' if i else 'ROOT'} j {{ OFFSET 0 1 0 CHANNELS 0\n" for i in range(depth))
        joints = joints.replace("CHANNELS 0", "CHANNELS 1 Yrotation", 1)
        return f"HIERARCHY {joints}{'}' * depth} MOTION\nFrames: 1\nFrame Time: 0.01\n90\n"

    assert positions(parse(folder, chain(3000)))["j#3000"][0].tolist() == [0, 3000, 0]
    with pytest.raises(SourceError, match="more than 10000 joints"):
        parse(folder, chain(10_001))


@settings(max_examples=150)
@given(st.binary(max_size=400))
def test_any_bytes_end_in_frames_or_an_error(folder: Path, data: bytes) -> None:
    for text in (
        data,
        b"HIERARCHY ROOT a {" + data,
        TEXT.encode() + data,
        TEXT[: TEXT.index("MOTION")].encode() + data,
    ):
        found = parse_or_fault(folder, text)
        if isinstance(found, Bvh):
            assert len(found.channels) > 0
        else:
            assert found.line is None or 1 <= found.line <= text.count(b"\n") + text.count(b"\r") + 1


KEYWORDS = ["{", "}", "ROOT", "JOINT", "End Site", "OFFSET", "CHANNELS", "3", "0", "-1", "1e308", "1e999", "nan"]
SIGNS = ["MOTION", "Frames: 9999999999", "Frame Time: 1e-320", "\n", "\r", "\0", "#", "//", "\ufeff", "\x1a", ":", "x"]
WORDS = st.sampled_from(KEYWORDS + SIGNS)


def parse_or_fault(folder: Path, text: str | bytes) -> Bvh | SourceError:
    try:
        return parse(folder, text)
    except SourceError as fault:
        return fault


@settings(max_examples=200)
@given(cuts=st.lists(st.tuples(st.integers(0, len(TEXT)), st.integers(0, 30), WORDS), min_size=1, max_size=4))
def test_a_file_with_words_cut_out_and_put_in_ends_in_frames_or_an_error(
    folder: Path, cuts: list[tuple[int, int, str]]
) -> None:
    text = TEXT
    for at, length, word in cuts:
        text = f"{text[:at]}{word}{text[at + length :]}"
    found = parse_or_fault(folder, text)
    if isinstance(found, Bvh):
        assert np.isfinite(found.channels).all()
        assert 1.0 <= found.rate_hz <= 10_000.0
    else:
        assert found.line is None or found.line >= 1
