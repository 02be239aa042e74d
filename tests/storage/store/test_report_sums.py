"""A report that is not as its stage wrote it is found by verify, by the plan of a run, and where it is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.store.history import SUMS, file_sums, refuse_damaged_report, wrong_files
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.flipped import flip_bit
from tests.storage.made_up import BODY, make_store

NAME = "results/reports/study/metrics.json"


@pytest.fixture
def report(tmp_path: Path) -> Path:
    store = make_store(tmp_path / "store", {"a": 30})
    (store / NAME).parent.mkdir(parents=True)
    (store / NAME).write_text("{}")
    summary = {"files": [NAME], SUMS: file_sums(store, [NAME])}
    with StoreWriter.open(store, BODY) as writer:
        writer.record_stage(StageRecord("study/evaluate", "", "r", "", 0.0, summary))
        writer.commit()
    return store / NAME


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_flipped_bit_in_a_report_is_found(report: Path, keep_time: bool) -> None:
    store = open_store(report.parents[3])
    assert verify(store) == []
    refuse_damaged_report(report)
    flip_bit(report, 1, keep_time=keep_time)
    assert [(finding.file, finding.fault) for finding in verify(store)] == [(NAME, True)]
    with pytest.raises(StoreError, match=r"metrics\.json: the report is damaged.* `kinedex repair"):
        refuse_damaged_report(report)


def test_a_report_that_was_removed_is_no_damage(report: Path) -> None:
    store = open_store(report.parents[3])
    report.unlink()
    assert [(finding.problem, finding.fault) for finding in verify(store)] == [("is missing", False)]


def test_reports_of_an_older_kinedex_and_files_elsewhere_are_not_checked(report: Path, tmp_path: Path) -> None:
    record = StageRecord("study/evaluate", "", "r", "", 0.0, {"files": [NAME]})
    assert list(wrong_files(report.parents[3], [record])) == []
    copy = tmp_path / "metrics.json"
    copy.write_text("[]")
    refuse_damaged_report(copy)
