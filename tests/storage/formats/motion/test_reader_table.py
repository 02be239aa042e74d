"""Readers of motion files: the right one is found by ending and content, plugins among them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog import plugins
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import reader_table
from kinedex.storage.formats.motion.reader import Body, MotionFile, Reader, ReadSettings
from kinedex.storage.formats.motion.reader_table import motion_endings, read_body, reader_of
from kinedex.storage.formats.motion.sources import scan
from tests.bvh_files import bvh_text, dance, mixamo

JOINTS = load_feature_set().joints


class StillReader(Reader):
    """Reads .still files, and .npy files of one letter: a body that stands at the origin."""

    format = "positions"
    endings = (".still", ".npy", ".fbx")

    def sniff(self, path: Path) -> bool:
        return path.suffix != ".npy" or path.read_bytes() == b"x"

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        frames = len(file.path.read_bytes())
        upright = np.repeat([[1.0], [0.0], [0.0], [0.0]], frames, axis=1)
        return Body(np.zeros((len(joints), 3, frames)), upright, 30.0, "1 m", "still", (), ())


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    class Distribution:
        name, version = "still-files", "1.2"

    class Point(EntryPoint):
        dist = Distribution()

    points = {"still": Point("still", f"{__name__}:StillReader", "kinedex.readers")}
    monkeypatch.setattr(plugins, "_installed", lambda group, path: points if group == "kinedex.readers" else {})
    reader_table._readers_by_ending.cache_clear()
    yield
    reader_table._readers_by_ending.cache_clear()


@pytest.mark.usefixtures("plugin")
def test_a_reader_of_a_plugin_is_found_and_asked_before_the_built_in_ones(tmp_path: Path) -> None:
    for name, content in {"a.still": b"abc", "b.npy": b"x", "c.npy": b"xy", "d.fbx": b"d"}.items():
        (tmp_path / name).write_bytes(content)
    assert type(reader_of(tmp_path / "a.still")).__name__ == "StillReader"
    assert reader_of(tmp_path / "a.still").distribution == "still-files 1.2"
    assert type(reader_of(tmp_path / "b.npy")).__name__ == "StillReader"
    assert type(reader_of(tmp_path / "c.npy")).__name__ == "PositionsReader"
    body = read_body(tmp_path / "a.still", None, load_mappings("auto", JOINTS), JOINTS)
    assert (body.frames, body.skeleton) == (3, "still")
    found = scan(tmp_path)
    assert [file.path for file in found.motions] == ["a.still", "b.npy", "c.npy", "d.fbx"]
    assert not found.unread


def test_built_in_readers_have_the_known_endings(tmp_path: Path) -> None:
    assert {".amc", ".bvh", ".c3d", ".npz", ".trc", ".csv", ".npy"} <= set(motion_endings())
    with pytest.raises(SourceError, match=r"a\.xyz: is not read; kinedex reads \.amc, \.bvh"):
        reader_of(tmp_path / "a.xyz")


def test_numbers_beyond_all_measure_are_refused_without_warnings_of_numpy(tmp_path: Path) -> None:
    text = bvh_text(mixamo(), dance(mixamo(), 2))
    place = text.index("OFFSET", text.index("JOINT"))
    path = tmp_path / "far.bvh"
    path.write_text(f"{text[:place]}OFFSET 1e200 0 0{text[text.index(chr(10), place) :]}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SourceError):
            read_body(path, None, load_mappings("auto", JOINTS), JOINTS)
