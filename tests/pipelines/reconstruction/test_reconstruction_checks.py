"""Rows of takes made from depth that contradict each other are found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.reconstruction.recordings import FILMED, filmed_by_depth

Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with a take that was made from depth."""
    folder = tmp_path_factory.mktemp("checks")
    filmed_by_depth(folder)
    given = {
        "recordings": str(folder / "rec" / "recordings.yaml"),
        "reconstruct.direction": "forward",
        "reconstruct.only": [FILMED[0]],
    }
    run_pipeline("depth", folder / "store", settings=given, executor="serial")
    return folder / "store"


def lent(rows: Rows) -> dict[str, Any]:
    return next(row for row in rows if row["hypothesis"] == "database" and row.get("winner", True))


def change(**values: object) -> Callable[[Rows], object]:
    return lambda rows: rows[3].update(values)


@pytest.mark.parametrize(
    ("kind", "broken", "problem"),
    [
        ("reconstructions", lambda rows: rows.append(rows[0]), "has two rows"),
        ("reconstructions", lambda rows: rows[0].update(source_frames=7), "more or fewer frames than it counts"),
        ("reconstructions", lambda rows: rows[0].update(unseen_frames=1), "frames without a pose than it counts"),
        ("reconstructions", lambda rows: rows.clear(), "has no row in `reconstructions`"),
        ("reconstruction_frames", lambda rows: rows.clear(), "has no rows in `reconstruction_frames`"),
        ("reconstruction_frames", lambda rows: rows.pop(3), "frame 4 is there twice, or the one before it is missing"),
        ("reconstruction_frames", change(source_frame=4), "frame 4 is there twice, or the one before it is missing"),
        ("reconstruction_frames", change(joints=[0.0] * 71), "has joints that are not 72 numbers"),
        ("reconstruction_frames", change(joints=None), "frames without a pose than it counts"),
        ("reconstruction_frames", change(hypothesis="guess"), "frame 3 has no such hypothesis"),
        ("reconstruction_frames", change(cost_local=1.0, cost_database=0.5), "a hypothesis that does not cost least"),
        ("reconstruction_frames", lambda rows: lent(rows).update(archive_frame=10**6), "another origin than"),
        ("reconstruction_frames", lambda rows: lent(rows).update(archive_take=None), "a frame without a take"),
        ("depth_votes", lambda rows: rows.clear(), "has no winner among its votes"),
        ("depth_votes", lambda rows: [row.update(winner=True) for row in rows], "has no winner among its votes"),
        ("depth_votes", lambda rows: lent(rows).update(cost=0.5), "has a winner of another cost than the frame"),
        ("depth_votes", lambda rows: lent(rows).update(archive_frame=1), "has a winner of another origin"),
        ("depth_votes", lambda rows: lent(rows).update(candidate=None), "has a candidate without a number"),
        ("reconstruction_errors", lambda rows: rows[0].update(over_10cm=1.5), "has a share beyond 0 and 1"),
        ("reconstruction_errors", lambda rows: rows[1].update(frames=100), "has more frames than its take"),
        ("reconstruction_errors", lambda rows: rows[-1].update(frames=9), "than each of them together"),
    ],
)
def test_rows_that_contradict_each_other_are_found(
    store: Path, monkeypatch: pytest.MonkeyPatch, kind: str, broken: Callable[[Rows], object], problem: str
) -> None:
    opened = open_store(store, at="newest")
    rows = opened.result(kind).select(result_schema(kind).names).to_pylist()
    broken(rows)
    wrong = pa.Table.from_pylist(rows, schema=result_schema(kind))
    pieces = opened.result_pieces

    def damaged(asked: str, parts: Iterable[ResultPart]) -> Iterator[pa.Table]:
        return iter([wrong]) if asked == kind else pieces(asked, parts)

    assert verify(opened) == []
    monkeypatch.setattr(opened, "result_pieces", damaged)
    found = [one.problem for one in verify(opened)]
    assert len(found) == 1, found
    assert problem in found[0]
