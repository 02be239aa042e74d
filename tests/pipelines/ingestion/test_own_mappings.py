"""Mappings of the user's own, from files, folders and the store, are added to the shipped ones and go before them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings, load_skeleton, own_files, with_own
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.ops.errors import ConfigError
from kinedex.pipelines.ingestion.store_repair import repair_store
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.version_changes import described, list_versions
from tests.commands.test_cli import kinedex
from tests.pipelines.archives import context, write_archive

JOINTS = load_feature_set().joints
NODES = {"Hip": 0, **{joint: i for i, joint in enumerate(JOINTS, 1)}}


def own(path: Path, name: str = "studio", **nodes: str) -> Path:
    """Write a mapping for BVH files whose nodes are called like the joints, but for some."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"name: {name}", "format: bvh", "up: z", "facing: x", "unit_m: 1", "joints:"]
    path.write_text("\n".join([*lines, *(f"  {joint}: {nodes.get(joint, joint)}" for joint in JOINTS), ""]))
    return path


def bring_in(store: Path, source: Path, **params: object) -> dict[str, object]:
    return Ingest().run(context(store), Ingest.parameters(source=str(source), **params))  # type: ignore[arg-type]


def test_a_mapping_of_the_users_own_wins_where_its_names_fit_and_only_there(tmp_path: Path) -> None:
    mappings = with_own(load_mappings("auto", JOINTS), own_files([own(tmp_path / "a.yaml")]), JOINTS)
    shipped = load_mappings("auto", JOINTS)
    assert shipped.detect("x", "bvh", NODES).mapping.name == "named"
    fit = mappings.detect("x", "bvh", NODES)
    assert (fit.mapping.name, fit.confidence) == ("studio", 1.0)
    assert fit.mapping.axes[1].tolist() == [0, 0, 1]
    other = {("Hips" if name == "root" else name): at for name, at in NODES.items() if name != "Hip"}
    assert mappings.nearest("bvh", other) is not None
    with pytest.raises(Exception, match="no skeleton mapping"):
        mappings.detect("x", "bvh", {"a": 0})
    assert mappings.digest("bvh") != shipped.digest("bvh")
    assert mappings.digest("c3d") == shipped.digest("c3d")


def test_a_mapping_that_is_forced_goes_before_those_that_are_added(tmp_path: Path) -> None:
    file = own(tmp_path / "a.yaml")
    mappings = with_own(load_mappings("named", JOINTS), own_files([file]), JOINTS)
    assert mappings.detect("x", "bvh", NODES).mapping.name == "named"


def test_folders_and_vocabularies_are_read_and_wrong_files_are_named(tmp_path: Path) -> None:
    own(tmp_path / "own/a.yaml")
    (tmp_path / "own/words.yaml").write_text("name: ours\nterms:\n  hips: [bassin]\n")
    (tmp_path / "own/readme.txt").write_text("nothing")
    mappings = with_own(load_mappings("auto", JOINTS), own_files([tmp_path / "own"]), JOINTS)
    assert mappings.vocabulary is not None
    assert "hips" in mappings.vocabulary.by_key["bassin"]
    assert mappings.digest("c3d") != load_mappings("auto", JOINTS).digest("c3d")
    own(tmp_path / "own/b.yaml")
    with pytest.raises(ConfigError, match=r"b\.yaml: name: .*a\.yaml has the name 'studio', too; rename one"):
        with_own(mappings, own_files([tmp_path / "own"]), JOINTS)
    (tmp_path / "own/b.yaml").write_text("name: x\n")
    with pytest.raises(ConfigError, match=r"expected a skeleton mapping \(`joints`\), names of nodes"):
        with_own(mappings, own_files([tmp_path / "own/b.yaml"]), JOINTS)
    (tmp_path / "empty").mkdir()
    for place, text in (("empty", "the folder holds no .yaml file"), ("none.yaml", "no such file or folder")):
        with pytest.raises(ConfigError, match=text):
            own_files([tmp_path / place])


def test_labels_of_markers_are_added_to_those_of_landmarks(tmp_path: Path) -> None:
    file = tmp_path / "labels.yaml"
    file.write_text("name: ours\nskin:\n  sided: {asis: [becken vorn]}\n")
    mappings = with_own(load_mappings("auto", JOINTS), own_files([file]), JOINTS)
    assert mappings.landmarks is not None
    labels = ["LBeckenVorn", "RBeckenVorn", "LPSI", "RPSI", "LKNE", "RKNE", "LANK", "RANK", "C7", "LSHO", "RSHO"]
    assert mappings.landmarks.read(labels).labels["lasis"] == ("LBeckenVorn",)
    assert "lasis" not in load_landmarks().read(labels).labels
    file.write_text("name: ours\nskin:\n  sided: {asys: [becken]}\n")
    with pytest.raises(ConfigError, match=r"labels\.yaml:3: skin\.sided\.asys: no such landmark; did you mean 'asis'"):
        with_own(load_mappings("auto", JOINTS), own_files([file]), JOINTS)


def acclaim(path: Path, name: str) -> Path:
    path.write_text(load_skeleton("acclaim", JOINTS).path.read_text().replace("name: acclaim", f"name: {name}"))
    return path


def test_a_store_keeps_mappings_and_every_ingest_and_repair_uses_them(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 9, "x_2.amc": 5}), tmp_path / "store"
    bring_in(store, source)
    assert kinedex("mapping", "list", store).stdout.startswith(f"{store} keeps no mappings")
    file = acclaim(tmp_path / "ours.yaml", "ours")
    assert kinedex("mapping", "add", store, file).returncode == 0
    file.unlink()
    assert kinedex("mapping", "list", store).stdout == "ours  for acclaim files\n"
    assert described(list_versions(store)[-1].changes) == "mappings: ours"
    assert bring_in(store, source)["read"] == 2
    assert set(open_store(store).takes()["skeleton"]) == {"ours"}
    assert bring_in(store, source)["read"] == 0
    # a file that is given takes the place of the kept one of its name
    given = acclaim(tmp_path / "given.yaml", "ours")
    assert bring_in(store, source, skeletons=str(given))["read"] == 0
    (part,) = open_store(store).manifest.frames[-1:]
    (store / part.path).write_bytes(b"nothing")
    assert repair_store(store, context(store).terminal).remaining == []
    assert set(open_store(store).takes()["skeleton"]) == {"ours"}
    text = json.loads(kinedex("mapping", "list", store, "--json").stdout)["mappings"][0]["text"]
    assert text == given.read_text() == read_newest(store).mappings["ours"]
    assert "did you mean 'ours'" in kinedex("mapping", "remove", store, "our").stderr
    assert kinedex("mapping", "remove", store, "ours").returncode == 0
    assert bring_in(store, source)["read"] == 2
    assert set(open_store(store, at="newest").takes()["skeleton"]) == {"acclaim"}
    assert not any(finding.fault for finding in verify(open_store(store, at="newest")))


def test_a_wrong_mapping_is_not_kept(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 9}), tmp_path / "store"
    bring_in(store, source)
    file = tmp_path / "wrong.yaml"
    file.write_text(acclaim(tmp_path / "a.yaml", "a").read_text().replace("\n  head:", "\n  heda:", 1))
    ended = kinedex("mapping", "add", store, file)
    assert ended.returncode == 1
    assert "did you mean 'head'" in ended.stderr.replace("\n", " ")
    assert read_newest(store).mappings == {}


def test_the_command_ingest_takes_a_folder(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 9}), tmp_path / "store"
    (tmp_path / "own").mkdir()
    acclaim(tmp_path / "own/ours.yaml", "ours")
    given = ("--executor", "serial", "--set", f"skeletons={tmp_path}/own")
    assert kinedex("ingest", store, source, *given).returncode == 0
    assert set(open_store(store).takes()["skeleton"]) == {"ours"}
    assert read_newest(store).sources[str(source)].settings["skeletons"] == [f"{tmp_path}/own"]


def test_a_mapping_that_fits_no_file_is_reported(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 9})
    file = acclaim(tmp_path / "ours.yaml", "ours")
    file.write_text(file.read_text().replace("lfemur", "lthigh"))
    place = context(tmp_path / "store")
    Ingest().run(place, Ingest.parameters(source=str(source), skeletons=[str(file)]))
    message = " ".join(place.terminal.console.file.getvalue().split())  # type: ignore[attr-defined]
    assert "the mapping 'ours'" in message
    assert "fits none of the files that were read" in message
    assert set(open_store(tmp_path / "store").takes()["skeleton"]) == {"acclaim"}
