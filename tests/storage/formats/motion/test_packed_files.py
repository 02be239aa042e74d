"""Files in .zip archives and .gz files: what is read of them, and what is refused so that no archive does harm."""

from __future__ import annotations

import gzip
import os
import random
import stat
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import packed_files, unpacked_files
from kinedex.storage.formats.motion.packed_files import archive, file_exists, opened, split_ending
from kinedex.storage.formats.motion.sources import checksum, scan
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.temporary_folders import PREFIX
from tests.bvh_files import bvh_text, dance, mixamo

WALK = bvh_text(mixamo(), dance(mixamo(), 9)).encode()


def pack(path: Path, files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """Write an archive whose files have exactly these names."""
    with zipfile.ZipFile(path, "w", method) as packed, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there twice
        for name, data in files.items():
            record = zipfile.ZipInfo("x")
            record.filename = name
            record.compress_type = method
            packed.writestr(record, data)
    return path


def content(path: Path) -> bytes:
    with opened(path) as file:
        return b"".join(iter(lambda: file.read(1000), b""))


def refusals(root: Path) -> dict[str, str]:
    return {one.path: str(one.fault) for one in scan(root).refused}


@contextmanager
def limits(monkeypatch: pytest.MonkeyPatch, **values: int) -> Iterator[None]:
    with monkeypatch.context() as patch:
        for name, value in values.items():
            patch.setattr(packed_files, name, value)
        packed_files._archive.cache_clear()
        yield
    packed_files._archive.cache_clear()


def test_a_packed_file_has_the_bytes_and_the_checksum_of_the_file_itself(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_bytes(WALK)
    (tmp_path / "walk.bvh.gz").write_bytes(gzip.compress(WALK))
    pack(tmp_path / "a.ZIP", {"deep/er/walk.bvh": WALK})
    pack(tmp_path / "b.zip", {"walk.bvh": WALK}, zipfile.ZIP_STORED)
    for name in ("walk.bvh", "walk.bvh.gz", "a.ZIP/deep/er/walk.bvh", "b.zip/walk.bvh"):
        path = tmp_path / name
        assert file_exists(path)
        assert content(path) == WALK
        assert checksum(path) == checksum(tmp_path / "walk.bvh")
        with unpacked(path) as copy:
            assert copy.path.read_bytes() == WALK
            assert (copy.path.stem, copy.path.suffix) == ("walk", ".bvh")
    assert not file_exists(tmp_path / "b.zip/run.bvh")
    assert not file_exists(tmp_path / "c.zip/walk.bvh")


def test_a_scan_lists_the_files_of_archives_like_those_of_folders(tmp_path: Path) -> None:
    files = {"walk.bvh": WALK, "walk.yaml": b"class: walk\n", "sub/run.bvh": WALK, "sub/x.asf": b"", "film.mp4": b"",
             "notes.txt": b"", "__MACOSX/._walk.bvh": b"", "table.csv": b"a,b\n1,2\n", "dance.htr": b""}  # fmt: skip
    for name, data in files.items():
        place = tmp_path / "plain" / "a" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
    (tmp_path / "packed").mkdir()
    pack(tmp_path / "packed" / "a.zip", files)
    plain, packed = scan(tmp_path / "plain"), scan(tmp_path / "packed")
    for name in ("motions", "skeletons", "unread", "sidecars", "passed_over", "refused"):
        listed = [one.path.replace("a.zip/", "a/") for one in getattr(packed, name)]
        assert sorted(listed) == sorted(one.path for one in getattr(plain, name)), name
    assert packed.passed_over_lines() == plain.passed_over_lines()
    assert [one.size for one in packed.motions] == [len(WALK), len(WALK)]
    assert [(one.stem, one.format) for one in packed.motions] == [("run", "bvh"), ("walk", "bvh")]


def test_an_empty_archive_is_counted(tmp_path: Path) -> None:
    pack(tmp_path / "a.zip", {})
    assert [(one.path, one.kind) for one in scan(tmp_path).passed_over] == [("a.zip", "archives that hold no files")]


def test_a_file_ending_with_gz_is_what_is_packed_in_it(tmp_path: Path) -> None:
    for name in ("walk.bvh.gz", "x.asf.gz", "notes.txt.gz", "all.tar.gz", "walk.gz", "t.csv.gz", "dance.htr.gz"):
        (tmp_path / name).write_bytes(gzip.compress(b"a,b\n1,2\n"))
    found = scan(tmp_path)
    assert [(one.path, one.stem, one.format, one.size) for one in found.motions] == [("walk.bvh.gz", "walk", "bvh", 8)]
    assert [one.path for one in found.skeletons] == ["x.asf.gz"]
    assert [one.path for one in found.unread] == ["dance.htr.gz"]
    assert {one.path: one.kind for one in found.passed_over} == {
        "notes.txt.gz": "archives, which are not unpacked", "all.tar.gz": "archives, which are not unpacked",
        "walk.gz": "archives, which are not unpacked",
        "t.csv.gz": "tables or data in which no reader finds motion",
    }  # fmt: skip


ODD = {
    "/etc/walk.bvh": "absolute path", "C:/walk.bvh": "absolute path", "C:walk.bvh": "absolute path",
    "\\\\host\\share\\walk.bvh": "absolute path", "../walk.bvh": "leads out", "a/../../walk.bvh": "leads out",
    "a\\..\\..\\walk.bvh": "leads out", "./walk.bvh": "no ordinary path", "a//walk.bvh": "no ordinary path",
    "wa\nlk.bvh": "no ordinary path", "walk.bvh\0.png": "no ordinary path", "a" * 252 + ".bvh": "no ordinary path",
    "/".join(["é" * 100] * 6) + "/a.bvh": "no ordinary path",
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_names_that_lead_elsewhere_are_refused_with_archive_and_name(tmp_path: Path, name: str) -> None:
    pack(tmp_path / "a.zip", {name: WALK, "sound.bvh": WALK})
    found = scan(tmp_path)
    assert [one.path for one in found.motions] == ["a.zip/sound.bvh"]
    (refused,) = found.refused
    assert ODD[name] in refused.fault.reason
    assert str(refused.fault).startswith(f"{tmp_path}/a.zip: '")
    assert refused.path.startswith("a.zip/")
    assert ".." not in refused.path


@given(
    names=st.lists(
        st.lists(
            st.sampled_from(["..", ".", "", "a", "b.zip", "C:", "\\", "/", "\0", "\n", "é", "walk.bvh"]), max_size=5
        )
        .map("/".join)
        .filter(bool),
        max_size=6,
    )
)
def test_no_name_reaches_out_of_the_archive(tmp_path_factory: pytest.TempPathFactory, names: list[str]) -> None:
    root = tmp_path_factory.mktemp("names")
    with zipfile.ZipFile(root / "a.zip", "w") as packed, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            record = zipfile.ZipInfo("x")
            record.filename = name
            packed.writestr(record, WALK)
    found = scan(root)
    for one in found.motions:
        assert one.path.startswith("a.zip/")
        assert not {"..", ".", ""} & set(one.path.split("/"))
        with unpacked(one.absolute) as copy:
            base = next(folder for folder in copy.path.parents if folder.name.startswith(PREFIX))
            assert copy.path.resolve() == base.resolve() / one.path.removeprefix("a.zip/")
            assert copy.path.read_bytes() == WALK
    files = {name for name in names if not name.endswith("/")}
    assert len(found.motions) <= len(files)
    assert found.count >= (1 if files else 0)
    assert os.listdir(root) == ["a.zip"]


def test_backslashes_of_old_programs_divide_folders(tmp_path: Path) -> None:
    pack(tmp_path / "a.zip", {"sub\\walk.bvh": WALK})
    assert [one.path for one in scan(tmp_path).motions] == ["a.zip/sub/walk.bvh"]
    assert content(tmp_path / "a.zip/sub/walk.bvh") == WALK


def test_files_that_are_there_twice_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        packed.writestr("walk.bvh", WALK)
        packed.writestr("walk.bvh", b"another")
    assert "more than once" in refusals(tmp_path)["a.zip/walk.bvh"]
    with pytest.raises(SourceError, match=r"a\.zip/walk\.bvh: is in the archive more than once"):
        content(tmp_path / "a.zip/walk.bvh")


def test_links_devices_and_archives_in_archives_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
        for name, kind in (("link.bvh", stat.S_IFLNK), ("pipe.bvh", stat.S_IFIFO), ("file.bvh", stat.S_IFREG)):
            record = zipfile.ZipInfo(name)
            record.create_system, record.external_attr = 3, (kind | 0o644) << 16
            packed.writestr(record, b"/etc/passwd")
        packed.writestr("inner.zip", b"")
        packed.writestr("walk.bvh.gz", gzip.compress(WALK))
    found = refusals(tmp_path)
    assert set(found) == {"a.zip/link.bvh", "a.zip/pipe.bvh", "a.zip/inner.zip", "a.zip/walk.bvh.gz"}
    assert "is a link in the archive, which is not followed" in found["a.zip/link.bvh"]
    assert "a pipe or a socket" in found["a.zip/pipe.bvh"]
    assert "one level deep" in found["a.zip/inner.zip"]
    assert "one level deep" in found["a.zip/walk.bvh.gz"]
    assert [one.path for one in scan(tmp_path).motions] == ["a.zip/file.bvh"]


def test_an_archive_that_is_a_link_out_of_the_source_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    pack(tmp_path / "a.zip", {"walk.bvh": WALK})
    (tmp_path / "source/a.zip").symlink_to(tmp_path / "a.zip")
    assert "outside the source" in refusals(tmp_path / "source")["a.zip"]
    (tmp_path / "source/walk.bvh.gz").symlink_to(tmp_path / "a.zip")
    assert "outside the source" in refusals(tmp_path / "source")["walk.bvh.gz"]


def test_encrypted_files_and_rare_methods_are_refused_with_the_way_out(tmp_path: Path) -> None:
    data = bytearray(pack(tmp_path / "a.zip", {"walk.bvh": WALK}).read_bytes())
    for at in (data.index(b"PK\x03\x04") + 6, data.index(b"PK\x01\x02") + 8):
        data[at] |= 1
    (tmp_path / "a.zip").write_bytes(data)
    pack(tmp_path / "b.zip", {"walk.bvh": WALK}, zipfile.ZIP_LZMA)
    found = refusals(tmp_path)
    assert "is encrypted; unpack the archive with its password" in found["a.zip/walk.bvh"]
    assert "only stored and deflated files are read: unpack the archive" in found["b.zip/walk.bvh"]


def test_damaged_and_cut_off_archives_are_refused_by_name(tmp_path: Path) -> None:
    whole = pack(tmp_path / "a.zip", {"walk.bvh": WALK, "run.bvh": WALK}).read_bytes()
    (tmp_path / "a.zip").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "b.zip").write_bytes(b"no archive")
    (tmp_path / "c.zip").write_bytes(b"")
    found = refusals(tmp_path)
    assert set(found) == {"a.zip", "b.zip", "c.zip"}
    assert all("damaged or cut off" in reason for reason in found.values())
    assert not scan(tmp_path).motions
    packed = gzip.compress(WALK)
    damaged = bytearray(packed)
    damaged[-6] ^= 1
    for name, data in {"x.bvh.gz": packed[:-20], "y.bvh.gz": WALK, "z.bvh.gz": bytes(damaged)}.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(SourceError, match=rf"{name}: cannot be unpacked, since it is damaged or cut off"):
            content(tmp_path / name)
    data = bytearray(pack(tmp_path / "d.zip", {"walk.bvh": WALK}).read_bytes())
    data[200] ^= 255
    (tmp_path / "d.zip").write_bytes(data)
    with pytest.raises(SourceError, match=r"d\.zip/walk\.bvh: cannot be unpacked, since it is damaged or cut off"):
        content(tmp_path / "d.zip/walk.bvh")


def test_a_record_that_states_another_size_yields_no_more_than_it_states(tmp_path: Path) -> None:
    for stated in (10, len(WALK) + 10):
        data = bytearray(pack(tmp_path / "a.zip", {"walk.bvh": WALK}).read_bytes())
        struct.pack_into("<I", data, data.index(b"PK\x01\x02") + 24, stated)
        (tmp_path / "a.zip").write_bytes(data)
        packed_files._archive.cache_clear()
        with pytest.raises(SourceError, match="damaged or cut off"):
            content(tmp_path / "a.zip/walk.bvh")


def test_bombs_are_refused_before_they_fill_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    zeros = bytes(3 << 20)
    pack(tmp_path / "a.zip", {"zeros.bvh": zeros, "walk.bvh": WALK})
    (tmp_path / "zeros.bvh.gz").write_bytes(gzip.compress(zeros))
    with limits(monkeypatch, FREE_BYTES=1 << 20):
        assert "200 times as much" in refusals(tmp_path)["a.zip/zeros.bvh"]
        with pytest.raises(SourceError, match=r"zeros\.bvh\.gz: has .* 200 times as much"):
            content(tmp_path / "zeros.bvh.gz")
        with pytest.raises(SourceError), unpacked(tmp_path / "zeros.bvh.gz"):
            pass
    with limits(monkeypatch, MAX_FILE=1 << 20):
        assert "packed files have at most" in refusals(tmp_path)["a.zip/zeros.bvh"]
        with pytest.raises(SourceError, match="unpacks to more than"):
            content(tmp_path / "zeros.bvh.gz")
    with limits(monkeypatch, FREE_BYTES=1 << 16):
        assert "200 times their size" in refusals(tmp_path)["a.zip"]
    with limits(monkeypatch, MAX_ARCHIVE=1 << 20):
        assert "archives hold at most" in refusals(tmp_path)["a.zip"]
    with limits(monkeypatch, MAX_MEMBERS=1):
        assert "holds 2 files; archives have at most 1" in refusals(tmp_path)["a.zip"]
    with limits(monkeypatch, MAX_DIRECTORY=100):
        assert "its list of files has more than" in refusals(tmp_path)["a.zip"]
    assert content(tmp_path / "a.zip/zeros.bvh") == zeros


def test_nothing_of_an_unpacked_file_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    pack(tmp_path / "a.zip", {"walk.bvh": WALK})
    seen = []

    def fail(path: Path) -> None:
        seen.append((path.is_relative_to(tmp_path / "tmp"), path.is_file(), stat.S_IMODE(path.parent.stat().st_mode)))
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), unpacked(tmp_path / "a.zip/walk.bvh") as copy:
        fail(copy.path)
    assert seen == [(True, True, 0o700)]
    assert os.listdir(tmp_path / "tmp") == []


def test_an_error_on_the_copy_names_the_original(tmp_path: Path) -> None:
    pack(tmp_path / "a.zip", {"sub/walk.bvh": WALK})
    with pytest.raises(SourceError) as fault, unpacked(tmp_path / "a.zip/sub/walk.bvh") as copy:
        raise SourceError(copy.path, f"is not like {copy.path.parent}/run.bvh", line=3)
    assert str(fault.value) == f"{tmp_path}/a.zip/sub/walk.bvh:3: is not like {tmp_path}/a.zip/sub/run.bvh"


def test_a_replaced_archive_is_listed_anew(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.zip", {"walk.bvh": WALK})
    assert list(archive(path).members) == ["walk.bvh"]
    pack(path, {"run.bvh": WALK, "jump.bvh": WALK})
    assert list(archive(path).members) == ["run.bvh", "jump.bvh"]


def test_a_copy_that_the_disk_refuses_says_what_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pack(tmp_path / "a.zip", {"walk.bvh": WALK})

    def full(self: Path, *_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(unpacked_files.Path, "mkdir", full)
    folder = tmp_path / "tmp"
    with pytest.raises(SourceError, match=r"walk\.bvh: cannot be unpacked into .*: No space left on device; .*TMPDIR"):
        unpacked_files._write(tmp_path / "a.zip/walk.bvh", folder / "walk.bvh")


def test_random_bytes_make_no_other_error_than_a_refusal(tmp_path: Path) -> None:
    dice = random.Random(33)
    whole = pack(tmp_path / "a.zip", {"walk.bvh": WALK[:2000], "b/run.bvh": WALK[:900], "x.csv": b"1,2\n"}).read_bytes()
    (tmp_path / "a.zip").unlink()
    (tmp_path / "source").mkdir()
    for turn in range(300):
        data = bytearray(whole)
        for _ in range(dice.randint(1, 4)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        path = tmp_path / "source" / "a.zip"
        path.write_bytes(data[: dice.choice([len(data), dice.randrange(len(data))])])
        os.utime(path, ns=(turn, turn))
        for one in scan(tmp_path / "source").motions:
            with suppress(SourceError):
                content(one.absolute)


@pytest.mark.parametrize(
    ("path", "divided"),
    [
        ("a/walk.bvh", ("a/walk", ".bvh")), ("a.b/walk.BVH.GZ", ("a.b/walk", ".BVH")), ("walk.gz", ("walk", ".gz")),
        ("walk", ("walk", "")), (".gz", (".gz", "")), ("a.gz/walk.bvh", ("a.gz/walk", ".bvh")),
    ],
)  # fmt: skip
def test_gz_is_no_ending_of_its_own(path: str, divided: tuple[str, str]) -> None:
    assert split_ending(path) == divided
