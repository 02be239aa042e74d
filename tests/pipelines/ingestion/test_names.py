"""Ingest: takes of one name, takes that were named otherwise before, and sources of which nothing comes in."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError, NewStoreError
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive
from tests.pipelines.test_ingest import TAKES, bring_in


def test_of_many_takes_of_one_name_two_are_named_and_each_name_is_said_once(tmp_path: Path) -> None:
    paths = {f"{folder}/x_{number}.amc": 5 for folder in "abcd" for number in (1, 2)}
    source, store = write_archive(tmp_path / "source", {**paths, "x_3.amc": 5}), tmp_path / "store"
    place = context(store)
    assert Ingest().run(place, Ingest.parameters(source=str(source)))["left_out"] == 8
    log = {row["source"]: row["message"] for row in open_store(store).result("ingest_log").to_pylist()}
    assert len(log) == 8
    assert log["b/x_1.amc"] == (
        f"{source}/b/x_1.amc: 4 takes would be named 'x_1' (also a/x_1.amc, c/x_1.amc and 1 more); rename them, or "
        "set `name: path`"
    )
    message = place.terminal.console.file.getvalue()  # type: ignore[attr-defined]
    assert message.count("would be named 'x_1'") == message.count("would be named 'x_2'") == 1
    assert "more: SELECT" not in message


def test_takes_that_another_pipeline_has_named_are_not_read_again_under_other_names(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source, name="path")
    before = open_store(store).manifest.version
    with pytest.raises(NewStoreError, match=r"3 takes of this source are in the store under other names, such as "
                                            r"'a/x_1' \(here 'x_1'\).*with the pipeline.*a new store"):  # fmt: skip
        bring_in(store, source)
    assert open_store(store).manifest.version == before
    (source / "a/x_1.amc").unlink()
    summary = bring_in(store, source, prune=True)
    assert (summary["dropped"], summary["read"], summary["takes"]) == (3, 2, 2)
    assert open_store(store).takes()["name"].to_list() == ["x_2", "x_3"]
    assert verify(open_store(store, at="newest")) == []


def test_a_source_of_which_nothing_comes_in_ends_the_run_and_prunes_nothing(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    (source / "a/x_1.amc").unlink()
    for path in ("a/x_2.amc", "b/x_3.amc"):
        (source / path).write_text("no motion")
    with pytest.raises(KinedexError, match=r"none of the 2 files could be read; the reasons are above"):
        bring_in(store, source, prune=True)
    opened = open_store(store)
    assert opened.result("ingest_log").num_rows == 2
    assert opened.takes().height == 3
