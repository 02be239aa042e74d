"""Takes of packed files are those of the files themselves: in ingest, inspection, export, repair and labels."""

from __future__ import annotations

import codecs
import gzip
import json
import os
import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.store.store import open_store
from tests.bvh_files import dance, mixamo
from tests.fuzz import seeds
from tests.gltf_files import dancing_gltf
from tests.pipelines.archives import context, human_amc, human_asf, write_archive
from tests.point_files import keypoints_of
from tests.real_data import SHARED

BODY_25 = load_keypoint_set("body-25").order
PLACES = {"take_id", "name", "source", "source_root", "source_mtime_ns", "skeleton_source"}
"""The columns of takes that differ between a file and its packed twin."""

TEXTS: dict[str, Callable[[], dict[str, bytes]]] = {
    "bvh": seeds.bvh, "trc": seeds.trc, "csv": seeds.csv, "motive.csv": seeds.motive, "nexus.csv": seeds.nexus,
    "tsv": seeds.qualisys, "gltf": seeds.gltf, "mvnx": seeds.mvnx, "json": seeds.keypoints,
}  # fmt: skip
BINARY: dict[str, Callable[[], dict[str, bytes]]] = {
    "glb": seeds.glb, "fbx": seeds.fbx, "c3d": seeds.c3d, "npz": seeds.npz, "npy": seeds.npy, "amass.npz": seeds.amass,
    "humanml.npy": seeds.humanml, "pkl": seeds.pickled_keypoints,
}  # fmt: skip


def bring_in(store: Path, source: Path, executor: str = "serial", **params: Any) -> dict[str, Any]:
    return Ingest().run(context(store, executor=executor), Ingest.parameters(source=str(source), **params))


def run(*words: str | Path, code: int = 0) -> str:
    done = CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.output


def files_below(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def zipped(folder: Path, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in files_below(folder).items():
            packed.writestr(name, data)
    return path


def content(store: Path, shown: Callable[[str], str] = str) -> dict[str, Any]:
    """Takes by their plain sources and persons with all that does not name a place; frames; files with outcomes."""
    found: dict[str, Any] = {}
    with open_store(store) as opened:
        for row in opened.take_rows.to_pylist():
            frames = opened.frames(row["name"])
            kept = [name for name in frames.column_names if name not in ("take_id", "take")]
            key = shown(row["source"]), row.get("person")
            # texts, since a gap (NaN) does not equal itself
            texts = {name: repr(row[name]) for name in row.keys() - PLACES}
            found[str(key)] = texts, repr(frames.select(kept).to_pydict())
        for row in opened.result("source_files").to_pylist():
            found[f"file {shown(row['source'])}"] = row["outcome"], row["takes"]
    return found


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A source with files of all formats, skeletons and models beside and above, sidecars, and others."""
    root = tmp_path_factory.mktemp("plain") / "a"
    write_archive(root, {"deep/x_1.amc": 40, "x_2.amc": 24})
    for ending, made in {**TEXTS, **BINARY}.items():
        for name, data in made().items():
            (root / f"{name}_{ending}").write_bytes(data) if "." in ending else None
            stem = f"{name}-{ending.split('.')[0]}"
            (root / f"{stem}.{ending.split('.')[-1]}").write_bytes(data)
    (root / "sim").mkdir()
    (root / "sim/walk.osim").write_bytes(next(iter(seeds.opensim_model().values())))
    (root / "sim/walk.mot").write_bytes(next(iter(seeds.opensim_motion().values())))
    (root / "x_2.yaml").write_text("class: walk\n")
    (root / "broken.bvh").write_text("HIERARCHY\nROOT a\n{\nOFFSET 0 0 x\n")
    (root / "notes.md").write_text("notes")
    return root


@pytest.fixture(scope="module")
def unpacked_store(plain: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("store") / "store"
    bring_in(store, plain.parent)
    return store


def test_takes_of_an_archive_equal_those_of_its_files_to_the_bit(
    plain: Path, unpacked_store: Path, tmp_path: Path
) -> None:
    zipped(plain, tmp_path / "source/a.zip")
    bring_in(tmp_path / "store", tmp_path / "source")
    expected = content(unpacked_store)
    assert content(tmp_path / "store", lambda source: source.replace("a.zip/", "a/")) == expected
    assert sum(not key.startswith("file") for key in expected) > 20
    assert expected["file a/sim/walk.mot"] == ("in", 1)
    assert expected["file a/broken.bvh"] == ("refused", 0)
    with open_store(tmp_path / "store") as store:
        (row,) = [row for row in store.take_rows.to_pylist() if row["source"] == "a.zip/x_2.amc"]
        assert (row["name"], row["class"], row["skeleton_source"]) == ("x_2", "walk", "a.zip/x.asf")
        assert row["checksum"] == checksum(plain / "x_2.amc")
        assert row["source_bytes"] == (plain / "x_2.amc").stat().st_size
        messages = [row["message"] for row in store.result("ingest_log").to_pylist()]
    assert any(message.startswith(f"{tmp_path}/source/a.zip/broken.bvh:4: ") for message in messages)
    assert not any("kinedex-unpacked" in message for message in messages)


def test_takes_of_gz_files_equal_those_of_the_files_to_the_bit(
    plain: Path, unpacked_store: Path, tmp_path: Path
) -> None:
    for name, data in files_below(plain).items():
        place = tmp_path / "source/a" / (name if name.endswith((".yaml", ".md")) else f"{name}.gz")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data if place.suffix != ".gz" else gzip.compress(data))
    bring_in(tmp_path / "store", tmp_path / "source")
    found = content(tmp_path / "store", lambda source: source.removesuffix(".gz"))
    assert found.pop("file a/sim/walk.osim") is not None
    expected = content(unpacked_store)
    expected.pop("file a/sim/walk.osim")
    assert found == expected


def test_files_of_a_sequence_and_buffers_beside_are_unpacked_with_a_file(tmp_path: Path) -> None:
    root, scene = tmp_path / "plain/a", dancing_gltf(mixamo(), dance(mixamo(), 9))
    (root / "sub").mkdir(parents=True)
    (root / "c.gltf").write_bytes(scene.gltf("sub/d.bin"))
    (root / "sub/d.bin").write_bytes(scene.binary)
    for number, points in enumerate(keypoints_of(BODY_25, 12)):
        flat = np.concatenate([points, np.ones((25, 1))], axis=1).ravel().tolist()
        text = json.dumps({"version": 1.3, "people": [{"pose_keypoints_3d": flat}]})
        (root / f"walk_{number:012d}_keypoints.json").write_text(text)
    zipped(root, tmp_path / "source/a.zip")
    for name, data in files_below(root).items():
        place = tmp_path / "gz/a" / (f"{name}.gz" if name.endswith(("json", "gltf")) else name)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(gzip.compress(data) if place.suffix == ".gz" else data)
    for source, store in (("plain", "s1"), ("source", "s2"), ("gz", "s3")):
        bring_in(tmp_path / store, tmp_path / source, rate_hz=30.0)
    expected = content(tmp_path / "s1")
    assert expected["file a/walk_000000000000_keypoints.json"] == expected["file a/c.gltf"] == ("in", 1)
    assert content(tmp_path / "s2", lambda source: source.replace("a.zip/", "a/")) == expected
    found = content(tmp_path / "s3", lambda source: source.removesuffix(".gz"))
    walk = str(("a/walk_000000000000_keypoints.json", None))
    assert found[walk] == expected[walk]


@pytest.mark.skipif(sys.platform == "win32", reason="links")
def test_a_link_beside_a_packed_file_does_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    scene = dancing_gltf(mixamo(), dance(mixamo(), 9))
    (tmp_path / "source").mkdir()
    (tmp_path / "out.bin").write_bytes(scene.binary)
    (tmp_path / "source/c.gltf.gz").write_bytes(gzip.compress(scene.gltf("d.bin")))
    (tmp_path / "source/d.bin").symlink_to(tmp_path / "out.bin")
    with pytest.raises(KinedexError, match=r"c\.gltf\.gz: names d\.bin, which is not there"):
        kinedex.read(tmp_path / "source/c.gltf.gz")


def test_several_processes_read_an_archive_as_one_does(plain: Path, tmp_path: Path) -> None:
    zipped(plain / "deep", tmp_path / "source/a.zip")
    zipped(plain / "deep", tmp_path / "source/b.zip")
    for name in ("a", "b"):
        with zipfile.ZipFile(tmp_path / f"source/{name}.zip", "a") as packed:
            packed.writestr("x.asf", human_asf())
            packed.writestr("x_7.amc", human_amc(30, 7))
    for executor in ("serial", "processes"):
        assert bring_in(tmp_path / executor, tmp_path / "source", executor)["read"] == 4
    assert content(tmp_path / "serial") == content(tmp_path / "processes")


def test_only_takes_whose_files_in_an_archive_changed_are_read_again(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "plain", {"x_1.amc": 40, "x_2.amc": 24, "x_3.amc": 30})
    path = zipped(root, tmp_path / "source/a.zip")
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 3
    before = content(tmp_path / "store")
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 0
    os.utime(path, ns=(1, 1))
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 0
    with open_store(tmp_path / "store") as store:
        assert set(store.take_rows.column("source_mtime_ns").to_pylist()) == {1}
    changed = (root / "x_2.amc").read_text().replace("root 0 17", "root 0 18")
    assert len(changed) == (root / "x_2.amc").stat().st_size
    (root / "x_2.amc").write_text(changed)
    (root / "x_3.amc").unlink()
    (root / "x_4.amc").write_text(human_amc(10, 4))
    zipped(root, path)
    done = bring_in(tmp_path / "store", tmp_path / "source")
    assert (done["read"], done["unchanged"]) == (2, 1)
    after = content(tmp_path / "store")
    same = str(("a.zip/x_1.amc", None))
    assert after[same] == before[same]
    assert after.keys() - before.keys() == {str(("a.zip/x_4.amc", None)), "file a.zip/x_4.amc"}
    assert "file a.zip/x_3.amc" not in after


def test_an_archive_that_is_unpacked_or_packed_keeps_its_takes(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "source/a", {"x_1.amc": 40, "b/x_2.amc": 24})
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 2
    zipped(root, tmp_path / "source/a.zip")
    shutil.rmtree(root)
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 0
    with open_store(tmp_path / "store") as store:
        assert store.takes()["source"].to_list() == ["a.zip/x_1.amc", "a.zip/b/x_2.amc"]
        ids = store.takes()["take_id"].to_list()
    with zipfile.ZipFile(tmp_path / "source/a.zip") as packed:
        packed.extractall(root)
    (tmp_path / "source/a.zip").unlink()
    (root / "x_1.amc.gz").write_bytes(gzip.compress((root / "x_1.amc").read_bytes()))
    (root / "x_1.amc").unlink()
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 0
    with open_store(tmp_path / "store") as store:
        assert store.takes()["source"].to_list() == ["a/x_1.amc.gz", "a/b/x_2.amc"]
        assert store.takes()["take_id"].to_list() == ids


def test_an_archive_that_is_damaged_later_is_refused_and_its_takes_stay(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "plain", {"x_1.amc": 40})
    path = zipped(root, tmp_path / "source/a.zip")
    write_archive(tmp_path / "source", {"x_9.amc": 9})
    bring_in(tmp_path / "store", tmp_path / "source")
    path.write_bytes(path.read_bytes()[:-30])
    bring_in(tmp_path / "store", tmp_path / "source")
    with open_store(tmp_path / "store") as store:
        assert store.takes()["name"].to_list() == ["x_1", "x_9"]
        (row,) = store.result("ingest_log").to_pylist()
    assert row["source"] == "a.zip"
    assert row["message"].startswith(f"{path}: cannot be unpacked, since it is damaged or cut off")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_texts_in_utf16_are_read_as_in_utf8(encoding: str, tmp_path: Path) -> None:
    mark = codecs.BOM_UTF16_LE if encoding == "utf-16-le" else codecs.BOM_UTF16_BE
    files = {"x.asf": human_asf().encode(), "x_1.amc": human_amc(30, 1).encode()}
    files |= {"walk.osim": next(iter(seeds.opensim_model().values()))}
    files |= {"walk.mot": next(iter(seeds.opensim_motion().values()))}
    for ending, made in TEXTS.items():
        name, data = next(iter(made().items()))
        files[f"{name}-{ending}"] = data
    for name, data in files.items():
        for folder in ("plain", "source"):
            (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / "plain" / name).write_bytes(data)
        kept = name.endswith((".osim", ".mvnx"))
        (tmp_path / "source" / name).write_bytes(data if kept else mark + data.decode().encode(encoding))
    bring_in(tmp_path / "s1", tmp_path / "plain")
    bring_in(tmp_path / "s2", tmp_path / "source")
    bring_in(tmp_path / "s3", zipped(tmp_path / "source", tmp_path / "packed/a.zip").parent)
    expected = content(tmp_path / "s1")
    assert expected["file x_1.amc"] == expected["file walk.mot"] == ("in", 1)
    for store, shown in (("s2", str), ("s3", lambda source: source.removeprefix("a.zip/"))):
        found = content(tmp_path / store, shown)
        assert found.keys() == expected.keys()
        for key in found.keys() - {key for key in found if key.startswith("file")}:
            for name in ("checksum", "source_bytes", "recipe"):
                assert found[key][0].pop(name) is not None
                expected[key][0].pop(name, None)
        assert found == expected
    with open_store(tmp_path / "s2") as store:
        for row in store.take_rows.to_pylist():
            assert row["checksum"] == checksum(tmp_path / "source" / row["source"])
    assert bring_in(tmp_path / "s2", tmp_path / "source")["read"] == 0


def test_utf16_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    write_archive(tmp_path, {"x_1.amc": 20})
    data = codecs.BOM_UTF16_LE + human_amc(20, 2).encode("utf-16-le")
    (tmp_path / "x_2.amc").write_bytes(data[:-1])
    bring_in(tmp_path / "store", tmp_path)
    with open_store(tmp_path / "store") as store:
        (row,) = store.result("ingest_log").to_pylist()
    assert (
        row["message"]
        == f"{tmp_path}/x_2.amc: is no text in UTF-16, though it begins with its byte order mark; cut off?"
    )


def test_inspect_read_and_mapping_take_packed_files(plain: Path, tmp_path: Path) -> None:
    path = zipped(plain, tmp_path / "a.zip")
    shown = run("inspect", path / "deep/x_1.amc")
    assert f"{path}/x.asf" in shown.replace("\n", "")
    expected = run("inspect", plain / "deep/x_1.amc")
    assert [line for line in shown.splitlines() if "frames" in line] == [
        line for line in expected.splitlines() if "frames" in line
    ]
    assert run("inspect", path / "sim/walk.mot", "--json").replace(str(path), "") == run(
        "inspect", plain / "sim/walk.mot", "--json"
    ).replace(str(plain), "")
    take, twin = kinedex.read(path / "x_2.amc"), kinedex.read(plain / "x_2.amc")
    assert take.name == twin.name
    assert (take.words() == twin.words()).all()
    with pytest.raises(KinedexError, match=r"a\.zip/nowhere\.bvh: no such file"):
        kinedex.read(path / "nowhere.bvh")
    with pytest.raises(KinedexError, match=r"a\.zip: is an archive; give a file of it, such as .*a\.zip/"):
        kinedex.read(path)
    with pytest.raises(KinedexError, match=rf"{path}/broken\.bvh:4: "):
        kinedex.read(path / "broken.bvh")
    with pytest.raises(KinedexError, match=r"a\.zip' is not a folder: give the folder that holds the archive"):
        bring_in(tmp_path / "store", path)
    (tmp_path / "x_2.amc.gz").write_bytes(gzip.compress((plain / "x_2.amc").read_bytes()))
    (tmp_path / "x.asf.gz").write_bytes(gzip.compress((plain / "x.asf").read_bytes()))
    twin = kinedex.read(tmp_path / "x_2.amc.gz")
    assert (twin.name, twin.info["format"]) == ("x_2", "amc")
    assert (take.words() == twin.words()).all()


def test_channels_of_packed_takes_are_exported_and_damaged_stores_repaired(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "plain", {"x_1.amc": 40, "x_2.amc": 24})
    path = zipped(root, tmp_path / "source/a.zip")
    bring_in(tmp_path / "plain-store", root)
    bring_in(tmp_path / "store", tmp_path / "source")
    for store in ("plain-store", "store"):
        run("export", tmp_path / store, "x_1", "-o", tmp_path / f"{store}.amc")
    assert (tmp_path / "store.amc").read_bytes() == (tmp_path / "plain-store.amc").read_bytes()
    before = content(tmp_path / "store")
    (part,) = (tmp_path / "store/frames").glob("*.parquet")
    part.write_bytes(part.read_bytes()[:-50])
    assert "2 takes" in run("repair", tmp_path / "store")
    assert content(tmp_path / "store") == before
    path.write_bytes(b"")
    assert "a.zip/x_1.amc" in run("export", tmp_path / "store", "x_1", "-o", tmp_path / "late.amc", code=1)


def test_labels_find_the_takes_of_packed_files_by_their_names(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "plain", {"x_1.amc": 40})
    zipped(root, tmp_path / "source/a.zip")
    (tmp_path / "source/x_2.amc.gz").write_bytes(gzip.compress(human_amc(40, 2).encode()))
    (tmp_path / "source/x.asf").write_text(human_asf())
    bring_in(tmp_path / "store", tmp_path / "source")
    (tmp_path / "labels.csv").write_text("take,class,start,stop\nx_1,walk,0,20\nx_2,walk,0,20\nx_2,bow,20,30\n")
    run("labels", "import", tmp_path / "store", tmp_path / "labels.csv")
    with open_store(tmp_path / "store") as store:
        assert sorted(store.labels().column("take").to_pylist()) == ["x_1", "x_2", "x_2"]


@pytest.mark.parametrize("folder", ["bandai/dataset-1", "cmu/02", "wild/makehuman", "wild/Pose2Sim_Blender"])
def test_real_files_are_the_same_takes_in_an_archive(folder: str, tmp_path: Path) -> None:
    if not (SHARED / "data" / folder).is_dir():
        pytest.skip("no real data")
    (tmp_path / "plain/a").mkdir(parents=True)
    for file in sorted(path for path in (SHARED / "data" / folder).iterdir() if path.is_file())[:6]:
        shutil.copy(file, tmp_path / "plain/a")
    zipped(tmp_path / "plain/a", tmp_path / "packed/a.zip")
    for name in ("plain", "packed"):
        bring_in(tmp_path / f"{name}-store", tmp_path / name)
    expected = content(tmp_path / "plain-store")
    assert len(expected) > 3
    assert content(tmp_path / "packed-store", lambda source: source.replace("a.zip/", "a/")) == expected
