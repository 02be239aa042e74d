"""docs/sql.md: its reference is that of the views and macros, and everything in it runs on an archive of its own."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.generators.sql_reference import renewed
from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.catalog.sql.views import MACROS, VIEWS
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.template_methods import BestMethod, ThesisMethod
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.store.database_file import write_database
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context, write_archive
from tests.pipelines.labelled import BODY, Line

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "sql.md").read_text(encoding="utf-8")
STATEMENTS = re.findall(r"```sql\n(.*?)```", PAGE, re.DOTALL)
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Motion files that were read, indexed, learned from and annotated."""
    folder = tmp_path_factory.mktemp("docs")
    takes = {
        "x_bo_long_1.amc": 600,
        "x_al_long_2.amc": 400,
        "x_al_hop_1.amc": 90,
        "x_al_hop_2.amc": 99,
        "x_bo_sway_1.amc": 88,
    }
    source = write_archive(folder / "source", takes)
    patterns = [r"x_(?P<actor>[a-z]+)_(?P<class>hop|sway)_(?P<clip>\d)", r"x_(?P<actor>[a-z]+)_long_\d"]
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=patterns))
    Index().run(context(folder / "store", "index"), Index.parameters())
    line = Line(folder / "store")
    line.run(LearnTemplates)
    line.run(Annotate, tau=0.5)
    return open_store(folder / "store")


def test_the_reference_is_up_to_date() -> None:
    assert renewed(PAGE) == PAGE, "python -m docs.generators.sql_reference"


def test_the_page_has_every_view_and_macro_once() -> None:
    titles = re.findall(r"^### (\w+)", PAGE, re.MULTILINE)
    assert sorted(titles) == sorted([view.name for view in VIEWS] + [macro.name for macro in MACROS])
    assert len(STATEMENTS) > len(titles)


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda text: " ".join(text.split())[:50])
def test_every_statement_of_the_page_runs(store: Store, statement: str) -> None:
    assert store.sql(statement).num_columns > 0


def test_the_archive_of_the_examples_says_something(store: Store) -> None:
    empty = {name for name, example in _examples(store) if store.sql(example).num_rows == 0}
    nothing_stored = {view.name for view in VIEWS if view.origin == "results" and not store.result(view.name).num_rows}
    nothing_stored |= {view.name for view in VIEWS if view.origin == "labels"}  # nobody has labelled anything here
    nothing_stored |= {"limb_errors_above", "worst_limbs"}  # nobody has worn sensors here
    assert empty - nothing_stored <= {"word_runs", "annotated_takes", "runs_where", "followed_by"}
    assert not nothing_stored & {"templates", "annotations", "distance_curves", "annotated_takes"}


def test_annotations_can_be_chosen_by_what_the_page_says_of_their_method(store: Store) -> None:
    (meaning,) = (
        column.meaning
        for view in VIEWS
        for column in view.columns
        if column.name == "method" and view.name == "annotations"
    )
    named = set(re.findall("'([^']+)'", meaning))
    query = KeyframeQuery("q", "hop", (Keyframe("upper", 1, 1),), ())
    templates = read_templates(store, "test/learn_templates", "soft")
    classes = load_classes("own", ["hop", "sway"])
    found = {
        make_annotator(BODY, templates, classes, 0.05, 0.13, queries, method=method).label
        for queries in ((), (query,))
        for method in (ThesisMethod, BestMethod)
    }
    assert found == named
    (stored,) = set(store.result("annotations").column("method").to_pylist())
    assert stored in named
    assert store.sql("SELECT * FROM annotations WHERE method = 'templates'").num_rows > 0


def test_every_example_of_help_runs_and_is_on_the_page(store: Store) -> None:
    for name, example in _examples(store):
        assert f"```sql\n{example};\n```" in PAGE, name


def _examples(store: Store) -> list[tuple[str, str]]:
    return [(row["name"], row["example"]) for row in store.sql("SELECT name, example FROM help").to_pylist()]


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.strip().splitlines()[0])
def test_the_programs_of_the_page_run(store: Store, program: str) -> None:
    write_database(store)
    names: dict[str, object] = {}
    exec(program.replace("build/demo-store", str(store.path)), names)
    if "valid" in names:
        assert len(names["valid"]) == store.takes("seconds > 1")["frames"][0]  # type: ignore[arg-type]
        assert len(names["height"]) == 30  # type: ignore[arg-type]
        assert names["valid"].all()  # type: ignore[attr-defined]
    else:
        assert len(names["highest"])  # type: ignore[arg-type]
        assert len(names["found"])  # type: ignore[arg-type]
