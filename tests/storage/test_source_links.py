"""A scan of a source folder with links, loops, names that are not valid text, and unreadable folders."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from kinedex.ops.errors import SourceError, StoreError
from kinedex.storage.formats.motion.scanned_files import readable
from kinedex.storage.formats.motion.sources import checksum, scan

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links and raw bytes in names")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    root = tmp_path / "source"
    (root / "a").mkdir(parents=True)
    (root / "a/x.amc").write_text("1")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside/secret.amc").write_text("1")
    return root


def refused(root: Path) -> dict[str, str]:
    return {item.path: item.fault.reason for item in scan(root).refused}


def test_a_loop_of_links_ends_and_nothing_comes_twice(source: Path) -> None:
    (source / "a/up").symlink_to(source)
    (source / "b").symlink_to(source / "a")
    (source / "self").symlink_to(source / "self")
    found = scan(source)
    assert [file.path for file in found.motions] == ["a/x.amc"]
    assert found.refused == ()


def test_a_link_to_a_file_inside_the_source_is_read_like_the_file(source: Path) -> None:
    (source / "y.amc").symlink_to(source / "a/x.amc")
    (source / "a/object").write_text("22")
    (source / "z.amc").symlink_to("a/object")
    found = scan(source)
    found_files = sorted((file.path, file.size) for file in found.motions)
    assert found_files == [("a/x.amc", 1), ("y.amc", 1), ("z.amc", 2)]
    assert found.refused == ()


def test_what_leads_out_of_the_source_is_refused_with_where_it_leads(source: Path, tmp_path: Path) -> None:
    (source / "out.amc").symlink_to(tmp_path / "outside/secret.amc")
    (source / "a/folder").symlink_to(tmp_path / "outside")
    (source / "a/up.bvh").symlink_to("../../outside/secret.amc")
    said = refused(source)
    assert set(said) == {"out.amc", "a/folder", "a/up.bvh"}
    assert all(f"is a link to {tmp_path}/outside" in reason for reason in said.values())
    assert all("copy what it leads to into the source" in reason for reason in said.values())
    assert [file.path for file in scan(source).motions] == ["a/x.amc"]


def test_links_to_nowhere_circles_and_pipes_are_refused(source: Path) -> None:
    (source / "gone.amc").symlink_to("never.amc")
    (source / "circle.amc").symlink_to("circle.amc")
    os.mkfifo(source / "pipe.amc")
    (source / "notes.txt").symlink_to("never.txt")
    assert refused(source) == {
        "circle.amc": "cannot be read: Too many levels of symbolic links",
        "gone.amc": "cannot be read: No such file or directory",
        "pipe.amc": "is no file (but a pipe, a device or a socket, or a link to a folder)",
    }


def test_a_source_may_itself_be_a_link(source: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(source)
    assert scan(tmp_path / "link") == scan(source)


def test_a_folder_that_cannot_be_read_is_refused_and_hides_what_is_in_it(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = scan(source).digest
    (source / "b").mkdir()
    really = os.scandir

    def scandir(path: str) -> object:
        if str(path).endswith("/a"):
            raise PermissionError(13, "Permission denied", str(path))
        return really(path)

    monkeypatch.setattr(os, "scandir", scandir)
    found = scan(source)
    assert [(item.path, item.fault.reason) for item in found.refused] == [
        ("a", "the folder cannot be read: Permission denied")
    ]
    assert [found.hidden(path) for path in ("a/x.amc", "a/b/c.amc", "a", "ab/x.amc", "b/x.amc")] == [
        True, True, True, False, False,
    ]  # fmt: skip
    assert found.digest != before


def test_a_file_that_vanishes_while_the_source_is_listed_is_refused(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = os.lstat

    def lstat(path: str, **how: int) -> os.stat_result:
        if str(path).endswith(".amc"):
            raise FileNotFoundError(2, "No such file or directory", path)
        return really(path, **how)

    monkeypatch.setattr(os, "lstat", lstat)
    assert refused(source) == {"a/x.amc": "cannot be read: No such file or directory"}


def raw_file(folder: Path, name: bytes, content: str) -> None:
    try:
        with open(os.fsencode(folder) + b"/" + name, "w") as file:
            file.write(content)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")


def test_a_name_that_is_not_utf_8_is_shown_with_its_bytes_and_found_by_them(source: Path) -> None:
    raw_file(source, b"caf\xe9.amc", "333")
    motion = next(file for file in scan(source).motions if file.size == 3)
    assert (motion.path, motion.stem, motion.format) == (r"caf\xe9.amc", r"caf\xe9", "amc")
    assert motion.absolute.read_text() == "333"
    assert scan(source).digest == scan(source).digest
    motion.absolute.unlink()
    with pytest.raises(SourceError) as caught:
        checksum(motion.absolute)
    assert r"caf\xe9.amc: cannot be read" in str(caught.value).encode().decode()


def test_a_source_whose_own_name_is_not_utf_8_is_refused(source: Path, tmp_path: Path) -> None:
    raw = os.fsencode(tmp_path) + b"/arch\xe9"
    try:
        os.mkdir(raw)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    with pytest.raises(StoreError, match=r"arch\\xe9' is not UTF-8 text"):
        scan(os.fsdecode(raw))


def test_text_that_is_text_stays_as_it_is() -> None:
    assert readable("Füße/歩く.amc") == "Füße/歩く.amc"
    assert readable("a\udce9b") == r"a\xe9b"
