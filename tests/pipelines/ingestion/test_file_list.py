"""Every file of a source folder is counted: in, refused, a skeleton, not read, or passed over by kind."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.sources import scan
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import context, write_archive

OTHERS = {
    "readme.TXT": "texts", "film/x_1.mp4": "images or films", "film/x_2.mp4": "images or films",
    "film/cover.png": "images or films", "labels/x_1.eaf": "labels", "labels/all.csv": "tables or data in which no "
    "reader finds motion", "old.tar": "archives, which are not unpacked", "._x_1.amc": "hidden files and files of the "
    "system", ".hidden": "hidden files and files of the system", "strange.xyz": "files of other kinds", "LICENSE":
    "texts",
}  # fmt: skip


def bring_in(store: Path, source: Path, **params: object) -> tuple[dict[str, object], str]:
    output = io.StringIO()
    place = replace(context(store), terminal=Terminal(Console(file=output, width=400)))
    summary = Ingest().run(place, Ingest.parameters(source=str(source), **params))  # type: ignore[arg-type]
    return summary, output.getvalue()


@pytest.fixture
def source(tmp_path: Path) -> Path:
    source = write_archive(tmp_path / "source", {"a/x_1.amc": 9, "b/x_1.amc": 7, "x_2.amc": 5})
    (source / "x_3.amc").write_text("no motion")
    (source / "x_4.amc").symlink_to("nowhere")
    (source / "dance.htr").write_text("motion")
    for path in OTHERS:
        (source / path).parent.mkdir(exist_ok=True)
        (source / path).write_text("take,class,start,stop\n")
    return source


def test_every_file_is_in_one_list_of_a_scan(source: Path) -> None:
    found = scan(source)
    files = [path for path in source.rglob("*") if not path.is_dir()]
    assert found.count == len(files) == 18
    assert {file.path: file.kind for file in found.passed_over} == OTHERS


def test_sums_of_the_list_add_up_and_sql_shows_it(source: Path, tmp_path: Path) -> None:
    summary, output = bring_in(tmp_path / "store", source)
    assert (summary["read"], summary["left_out"], summary["not_read"], summary["passed_over"]) == (3, 2, 1, 11)
    with open_store(tmp_path / "store") as opened:
        rows = opened.sql("SELECT outcome, count(*) AS files, sum(takes) AS takes FROM source_files GROUP BY ALL")
        counts = {row["outcome"]: (row["files"], row["takes"]) for row in rows.to_pylist()}
        assert counts == {"in": (3, 3), "refused": (2, 0), "skeleton": (1, 0), "not read": (1, 0),
                          "passed over": (11, 0)}  # fmt: skip
        reasons = {row["source"]: row["reason"] for row in opened.result("source_files").to_pylist()}
    assert "x_3.amc" in reasons["x_3.amc"]
    assert "cannot be read" in reasons["x_4.amc"]
    assert reasons["dance.htr"] == "export it as BVH"
    assert reasons["strange.xyz"] == "files of other kinds"
    assert "1 skeleton file\n" in output
    assert "passed over as images or films: 3 (.mp4 2, .png 1)\n" in output
    assert "passed over as texts: 2 (without an ending 1, .txt 1)\n" in output
    assert "1 file of a format not read (.htr): export it as BVH\n" in output
    assert bring_in(tmp_path / "store", source)[0]["unchanged"] == 3
    assert {row["outcome"] for row in open_store(tmp_path / "store").result("source_files").to_pylist()} == set(counts)


def test_files_before_which_strict_stopped_are_listed_as_not_read(source: Path, tmp_path: Path) -> None:
    with pytest.raises(KinedexError, match="strict"):
        bring_in(tmp_path / "store", source, strict=True)
    rows = open_store(tmp_path / "store").result("source_files").to_pylist()
    assert len(rows) == 18
    assert {row["reason"] for row in rows if row["outcome"] == "not read"} >= {"strict stopped before this file"}


def test_a_copy_of_a_file_names_the_one_that_was_read(source: Path, tmp_path: Path) -> None:
    bring_in(tmp_path / "store", source)
    copy = write_archive(tmp_path / "copy", {})
    (copy / "x_2.amc").write_bytes((source / "x_2.amc").read_bytes())
    bring_in(tmp_path / "store", copy)
    rows = {row["source"]: row for row in open_store(tmp_path / "store").result("source_files").to_pylist()}
    assert rows["x_2.amc"]["reason"] == f"has the content of {source}/x_2.amc"


def test_a_folder_without_motion_files_is_described(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    with pytest.raises(KinedexError, match=r"below .*; is this the right folder\? It holds no file\."):
        bring_in(tmp_path / "store", tmp_path / "source")
    for name in ("a.png", "b.png", "c.csv", "d.htr", "e.asf"):
        (tmp_path / "source" / name).write_text("x,y\n1,2\n")
    with pytest.raises(KinedexError) as fault:
        bring_in(tmp_path / "store", tmp_path / "source")
    for text in ("Of 5 files:", "1 skeleton file (.asf) without motion.", "passed over as images or films: 2 (.png 2).",
                 "passed over as tables or data in which no reader finds motion: 1 (.csv 1)",
                 "1 file of a format not read (.htr): export it as BVH."):  # fmt: skip
        assert text in str(fault.value)
