"""Cuts of a source's own channels: the same numbers byte by byte, and the same takes when they are read again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body.resample import covered_frames
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.amc_cuts import write_amc_cut
from kinedex.storage.formats.motion.asf import read_asf
from kinedex.storage.formats.motion.bvh_cuts import write_bvh_cut
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.channel_cuts import SourceCut
from kinedex.storage.formats.motion.sources import checksum
from tests.acclaim_files import amc_text, asf_text, rest
from tests.bvh_files import bvh_text, dance, small, write_duet


def cut_of(source: Path, start: int, stop: int, skeleton: Path | None = None) -> SourceCut:
    return SourceCut(source, skeleton, None, start, stop, 30.0)


def bvh_file(path: Path, frames: int = 9, change: Callable[[str], str] = lambda text: text) -> Path:
    path.write_bytes(change(bvh_text(small(), dance(small(), frames))).encode())
    return path


@given(
    frames=st.integers(1, 400),
    source=st.sampled_from([30.0, 48.0, 50.0, 59.94, 60.0, 100.0, 120.0, 240.0]),
    data=st.data(),
)
def test_the_source_frames_of_an_interval_give_as_many_frames_as_it_has(
    frames: int, source: float, data: st.DataObject
) -> None:
    def count(n: int) -> int:
        return int(np.floor(round((n - 1) * 30.0 / source, 9))) + 1

    start = data.draw(st.integers(0, count(frames) - 1))
    stop = data.draw(st.integers(start + 1, count(frames)))
    first, last = covered_frames(start, stop, frames, source, 30.0)
    assert 0 <= first < last <= frames
    assert count(last - first) == stop - start
    assert abs(first - start * source / 30.0) < 1
    if (source / 30.0).is_integer():
        step = round(source / 30.0)
        assert (first, last) == (start * step, min(stop * step, frames))


def test_an_interval_outside_of_the_source_is_refused() -> None:
    for interval in ((0, 0), (3, 2), (-1, 2), (0, 12)):
        with pytest.raises(ParameterError, match="start and stop"):
            covered_frames(*interval, 40, 120.0, 30.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: "\ufeff" + text.replace("Frames: ", "Frames:\t").replace(" ", "   "),
        lambda text: text.rstrip("\n"),
        lambda text: text.replace("Frame Time: 0.0333333\n", "Frame Time: 0.0333333\n\n# taken in May\n") + "\n# end\n",
        lambda text: text.replace("Frames: 9", "Frames:8"),
    ],
)
def test_a_cut_of_a_bvh_file_has_its_bytes(tmp_path: Path, change: Callable[[str], str]) -> None:
    source, target = bvh_file(tmp_path / "a.bvh", 9, change), tmp_path / "cut.bvh"
    whole = parse_bvh(source)
    for start, stop in ((0, 9), (2, 5), (8, 9)):
        write_bvh_cut([target], cut_of(source, start, stop))
        found = parse_bvh(target)
        assert not found.warnings
        assert (found.rate_hz, [n.name for n in found.nodes]) == (whole.rate_hz, [n.name for n in whole.nodes])
        np.testing.assert_array_equal(found.channels, whole.channels[start:stop])
        rows = [row.split() for row in source.read_bytes().splitlines() if row.count(b".") > 20]
        assert [row.split() for row in target.read_bytes().splitlines() if row.count(b".") > 20] == rows[start:stop]
    write_bvh_cut([target], cut_of(source, 0, 9))
    assert target.read_bytes().rstrip() == source.read_bytes().replace(b"Frames:8", b"Frames: 9").rstrip()


def test_a_cut_of_a_file_of_several_persons_holds_one(tmp_path: Path) -> None:
    source, target = write_duet(tmp_path / "duet.bvh", 6), tmp_path / "cut.bvh"
    whole = parse_bvh(source)
    half = whole.channels.shape[1] // 2
    for person, columns in (("Ann", slice(0, half)), ("Ben", slice(half, None))):
        write_bvh_cut([target], replace(cut_of(source, 1, 4), person=person))
        found = parse_bvh(target)
        assert {node.name.split(":")[0] for node in found.nodes} == {person}
        np.testing.assert_array_equal(found.channels, whole.channels[1:4, columns])
    with pytest.raises(SourceError, match="no person 'Cy'; it has 'Ann', 'Ben'"):
        write_bvh_cut([target], replace(cut_of(source, 1, 4), person="Cy"))


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_cut_of_an_amc_file_is_numbered_from_1_with_its_skeleton_beside_it(tmp_path: Path, newline: str) -> None:
    asf, source = tmp_path / "a.asf", tmp_path / "a.amc"
    asf.write_bytes(asf_text(newline=newline).encode("latin-1"))
    text = amc_text(rest(7), newline=newline)
    source.write_bytes(text.encode("latin-1"))
    whole = AmcFile(source, read_asf(asf)).channels()
    targets = [tmp_path / "out.amc", tmp_path / "out.asf"]
    write_amc_cut(targets, cut_of(source, 2, 6, asf))
    found = AmcFile(targets[0], read_asf(targets[1])).channels()
    np.testing.assert_array_equal(found, whole[2:6])
    assert targets[1].read_bytes() == asf.read_bytes()
    lines = targets[0].read_bytes().decode("latin-1").split(newline)
    assert [line for line in lines if line.isdigit()] == ["1", "2", "3", "4"]
    assert [line for line in lines if line.startswith((":", "#"))] == [
        line for line in text.split(newline) if line.startswith((":", "#"))
    ]
    rows = [line for line in text.split(newline) if line and line[0].isalpha()]
    bones = len(rows) // 7
    assert [line for line in lines if line and line[0].isalpha()] == rows[2 * bones : 6 * bones]


def test_a_source_that_was_changed_or_is_gone_is_an_error(tmp_path: Path) -> None:
    source, target = bvh_file(tmp_path / "a.bvh"), tmp_path / "cut.bvh"
    cut = replace(cut_of(source, 0, 9), checksum=checksum(source))
    write_bvh_cut([target], cut)
    before = target.read_bytes()
    bvh_file(source, 8)
    with pytest.raises(SourceError, match=r"a.bvh: was changed since .* ingest it again \(kinedex ingest"):
        write_bvh_cut([target], cut)
    with pytest.raises(SourceError, match=r"has 8 frames, so that \[0, 9\) cannot be cut"):
        write_bvh_cut([target], replace(cut, checksum=None))
    source.unlink()
    with pytest.raises(SourceError, match=r"cannot be read: No such file .* export the 24 joints"):
        write_bvh_cut([target], cut)
    assert target.read_bytes() == before
    with pytest.raises(ParameterError, match="at least one frame"):
        write_bvh_cut([target], replace(cut_of(bvh_file(source), 3, 3)))


@pytest.mark.shared
def test_cuts_of_files_of_many_programs_have_their_numbers(shared: Path, tmp_path: Path) -> None:
    sources = [*sorted((shared / "data/wild").rglob("*.bvh")), *sorted((shared / "data/bandai").rglob("*.bvh"))[::100]]
    target = tmp_path / "cut.bvh"
    for source in sources:
        whole = parse_bvh(source)
        frames = len(whole.channels)
        for start, stop in ((0, frames), (frames // 3, frames // 3 + (frames + 1) // 2)):
            write_bvh_cut([target], cut_of(source, start, stop))
            found = parse_bvh(target)
            np.testing.assert_array_equal(found.channels, whole.channels[start:stop])
            assert [node.before.tolist() for node in found.nodes] == [node.before.tolist() for node in whole.nodes]
            assert found.rate_hz == whole.rate_hz
        write_bvh_cut([target], cut_of(source, 0, frames))
        assert target.read_bytes().split() == source.read_bytes().split()
    for source in (shared / "data/hdm05/takes/HDM_mm_take03.amc", shared / "data/cmu/01/01_01.amc"):
        asf = next(iter(source.parent.glob("*.asf")))
        frames = AmcFile(source, read_asf(asf)).frames
        write_amc_cut([tmp_path / "a.amc", tmp_path / "a.asf"], cut_of(source, 0, frames, asf))
        assert (tmp_path / "a.amc").read_bytes() == source.read_bytes()
