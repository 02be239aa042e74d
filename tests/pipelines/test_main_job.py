"""The main job, from motion files to the report: on the synthetic archive of the demo, and on real motion capture."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from kinedex.commands.demo import Demo, run_demo
from kinedex.pipelines.engine.runner import Outcome
from kinedex.pipelines.keyframes.store_search import load_query_file, search_store
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify

pytestmark = pytest.mark.slow


MINUTES = 10.0
"""Of synthetic motion: a third of what the demo makes unless asked otherwise, as most of its time is spent on that."""


def demo(store: Path, data: Path | None) -> tuple[Outcome, str]:
    message = io.StringIO()
    outcome = run_demo(Demo(store, MINUTES, "processes", None, Console(file=message, width=160)), data)
    return outcome, message.getvalue()


def metrics(store: Path, name: str = "metrics") -> dict[str, Any]:
    path = store / "results" / "reports" / "annotate" / f"{name}.json"
    loaded: dict[str, Any] = json.loads(path.read_text())
    return loaded


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome, str]:
    store = tmp_path_factory.mktemp("demo") / "store"
    return store, *demo(store, None)


def test_the_demo_annotates_what_it_has_not_seen(synthetic: tuple[Path, Outcome, str]) -> None:
    store, outcome, message = synthetic
    assert outcome.left_out == 0
    assert metrics(store)["pooled"]["f1"] >= 0.85
    assert "leave one actor out" in message
    (left_out,) = metrics(store, "leave_one_out.methods")["splits"]
    assert left_out["methods"]["annotate"]["pooled"]["f1"] >= 0.8
    assert verify(open_store(store, at="newest")) == []


@pytest.mark.parametrize(
    ("query", "motion_class"),
    [("kick_left", "kickLeft1Reps"), ("kick_right", "kickRight1Reps"), ("squat", "squat1Reps"), ("turn", "spinLeft")],
)
def test_the_shipped_queries_find_motions_of_the_demo(
    synthetic: tuple[Path, Outcome, str], query: str, motion_class: str
) -> None:
    opened = open_store(synthetic[0])
    hits = search_store(opened, load_query_file("example", opened.feature_set, [query]))
    clips = set(opened.takes(f"class = '{motion_class}'")["name"].to_list())
    assert len(clips & set(hits.column("take").to_pylist())) >= 0.9 * len(clips) > 0


def test_the_demo_ends_with_one_page_that_needs_nothing_else(synthetic: tuple[Path, Outcome, str]) -> None:
    _, outcome, _ = synthetic
    assert outcome.report is not None
    page = outcome.report.read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    assert len(page) < 20_000_000


def test_a_second_demo_does_nothing(synthetic: tuple[Path, Outcome, str]) -> None:
    store, first, _ = synthetic
    outcome, message = demo(store, None)
    assert outcome.ran == ()
    assert outcome.skipped == first.ran
    assert message.count("nothing to do") == len(first.ran)
    assert "made before" in message


@pytest.mark.shared
def test_real_takes_are_annotated_as_well_as_the_plain_implementation_does(shared: Path, tmp_path: Path) -> None:
    outcome, _ = demo(tmp_path / "store", shared / "data" / "hdm05")
    assert outcome.left_out == 0
    pooled = metrics(tmp_path / "store")["pooled"]
    assert pooled["f1"] >= 0.82
    assert pooled["f2"] >= 0.87
    actors = open_store(tmp_path / "store").takes("class IS NOT NULL")["actor"].unique().sort().to_list()
    assert actors == ["bd", "bk", "dg"]
