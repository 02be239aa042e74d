"""AMC and BVH files that are read in blocks have the numbers that a naive reader of the whole text finds."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import text_blocks
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import read_asf
from kinedex.storage.formats.motion.bvh_parser import BvhFile, parse_bvh
from tests.oracles import motion_text as naive
from tests.pipelines.archives import human_asf

HEADER = """HIERARCHY
ROOT a
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 1 0
}
}
MOTION
Frames: 9
Frame Time: 0.0333333
"""
NUMBERS = st.one_of(
    st.floats(-400, 400).map(lambda number: f"{number:.6g}"),
    st.floats(-400, 400).map(repr),
    st.sampled_from(
        ["0", "-0", "+1", "5.", ".5", "-1.5e-7", "123456789012345678901", "0.1000000000000000055511151231"]
    ),
)
ENDS = st.sampled_from(["\n", "\r\n", "\r"])
BETWEEN = st.sampled_from(["", "", "", "", "# a comment", " \t", "  # 5 indented"])
BLANKS = st.sampled_from([" ", " ", "  ", "\t"])
SIZES = st.integers(1, 700)


def lines(rows: list[list[str]], draw: Callable[..., object]) -> str:
    """Return rows of words as text, with ends of lines, blanks, empty lines and comments as they are drawn."""
    text = ""
    for words in rows:
        between = draw(BETWEEN)
        text += f"{between}{draw(ENDS)}" if between else ""
        text += f"{draw(st.sampled_from(['', '', ' ']))}{str(draw(BLANKS)).join(words)}{draw(ENDS)}"
    return text.rstrip("\r\n") if draw(st.booleans()) else text


@st.composite
def bvh_texts(draw: Callable[..., object]) -> str:
    """Draw BVH files of one joint."""
    rows = draw(st.lists(st.lists(NUMBERS, min_size=6, max_size=6), min_size=1, max_size=12))
    return HEADER.replace("\n", str(draw(ENDS))) + lines(rows, draw)  # type: ignore[arg-type]


SKELETON = human_asf()


@st.composite
def amc_texts(draw: Callable[..., object]) -> str:
    """Draw AMC files of the skeleton of the tests, whose bones stand in any order."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "a.asf").write_text(SKELETON)
        channels = read_asf(Path(folder) / "a.asf").channels
    numbers = draw(st.lists(NUMBERS, min_size=7, max_size=7))
    first, rows = draw(st.integers(1, 98)), []
    for frame in range(draw(st.integers(1, 4))):  # type: ignore[arg-type]
        order = draw(st.sampled_from([list(channels), list(channels)[::-1]]))
        rows.append([str(first + frame)])  # type: ignore[operator]
        rows += [[name, *(numbers[(frame + i) % 7] for i in range(len(dofs)))] for name, dofs in order]  # type: ignore
    return f"#!OML:ASF{draw(ENDS)}:FULLY-SPECIFIED{draw(ENDS)}:RADIANS{draw(ENDS)}" + lines(rows, draw)


def in_blocks(size: int, read: Callable[[], np.ndarray]) -> np.ndarray:
    """Read with blocks of a number of bytes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_blocks, "BLOCK", size)
        return read()


@given(bvh_texts(), SIZES)
def test_bvh_files_in_blocks_have_the_numbers_of_a_naive_reader(text: str, size: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bvh"
        path.write_bytes(text.encode())
        expected = np.array(naive.rows(text)) * np.where(np.arange(6) < 3, 1.0, np.pi / 180.0)
        np.testing.assert_array_equal(in_blocks(size, lambda: parse_bvh(path).channels), expected)
        parts = in_blocks(size, lambda: np.concatenate([part.copy() for part in BvhFile(path).blocks()]))
        np.testing.assert_array_equal(parts, expected)


@given(amc_texts(), SIZES)
def test_amc_files_in_blocks_have_the_numbers_of_a_naive_reader(text: str, size: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, asf = Path(folder) / "a.amc", Path(folder) / "a.asf"
        path.write_bytes(text.encode())
        asf.write_text(SKELETON)
        skeleton = read_asf(asf)
        kinds = [dof for _, dofs in skeleton.channels for dof in dofs]
        metres = skeleton.unit_m / skeleton.length_scale
        scale = np.array([1.0 if kind in ("rx", "ry", "rz") else metres for kind in kinds])
        expected = np.array(naive.frames(text, [name for name, _ in skeleton.channels])) * scale
        np.testing.assert_array_equal(in_blocks(size, lambda: AmcFile(path, skeleton).channels()), expected)
        read = lambda: np.concatenate([part.copy() for part in AmcFile(path, skeleton).blocks()])  # noqa: E731
        np.testing.assert_array_equal(in_blocks(size, read), expected)


@given(st.one_of(bvh_texts(), amc_texts()), SIZES, st.data())
def test_a_damaged_file_has_the_same_error_in_blocks_of_any_size(text: str, size: int, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(text) - 1), "place")
    other = data.draw(st.sampled_from(["", "x", " 1", "\n", "\r", "\n7\n", "1e999", "#", "\n\n"]), "put there")
    damaged = text[:at] + other + text[at + data.draw(st.integers(0, 30), "bytes taken away") :]
    with tempfile.TemporaryDirectory() as folder:
        path, asf = Path(folder) / ("a.bvh" if text.startswith("HIERARCHY") else "a.amc"), Path(folder) / "a.asf"
        path.write_bytes(damaged.encode())
        asf.write_text(SKELETON)

        def read() -> object:
            try:
                if path.suffix == ".bvh":
                    bvh = parse_bvh(path)
                    return bvh.channels.tobytes(), bvh.warnings
                motion = AmcFile(path, read_asf(asf))
                return motion.channels().tobytes(), motion.warnings
            except SourceError as fault:
                return str(fault)

        assert in_blocks(size, read) == read()  # type: ignore[arg-type, comparison-overlap]
