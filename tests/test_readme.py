"""The README and its five minutes of SQL: every statement runs, every command that it names exists, and it is short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query_reader import read_queries
from kinedex.commands.command_list import COMMANDS
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context, write_archive

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SQL = (ROOT / "docs" / "sql.md").read_text(encoding="utf-8")
STATEMENTS = re.findall(r'kinedex sql build/demo-store "([^"]+)"', README + SQL)
MAX_WORDS = 900
MAX_BYTES = 200_000


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("readme")
    source = write_archive(folder / "source", {"x_1.amc": 60, "x_2.amc": 90})
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source)))
    Index().run(context(folder / "store", "index"), Index.parameters())
    return open_store(folder / "store")


@pytest.mark.parametrize("statement", STATEMENTS, ids=lambda text: text.split("FROM")[0].strip()[:40])
def test_every_statement_of_the_tour_runs(store: Store, statement: str) -> None:
    assert store.sql(statement).num_columns > 0


def test_the_page_of_sql_has_its_five_minutes() -> None:
    assert len(STATEMENTS) >= 8


def test_the_readme_is_short() -> None:
    assert len(README.split()) <= MAX_WORDS


def test_the_pictures_of_the_readme_are_small() -> None:
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert len(pictures) == 2
    assert all((ROOT / picture).stat().st_size <= MAX_BYTES for picture in pictures)


def test_the_query_of_the_readme_is_shipped() -> None:
    (name,) = re.findall(r"kinedex search build/demo-store example --query (\w+)", README)
    assert name in {query.name for query in read_queries("example", load_feature_set())}


def test_the_readme_names_the_commands_that_there_are() -> None:
    (line,) = re.findall(r"`kinedex (demo \| [^`]+)`", README)
    assert set(line.split(" | ")) == {*COMMANDS}


def test_files_that_the_readme_links_to_exist() -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", README):
        assert (ROOT / target).is_file(), target
